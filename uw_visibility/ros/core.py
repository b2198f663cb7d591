# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Node core: topics in, a worker thread, topics out."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node

from uw_visibility.compute.jit import counts
from uw_visibility.compute.kernel_folder import writable_folder
from uw_visibility.errors import InputError
from uw_visibility.messages.frames import StereoFrame
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.messages.outputs import all_topics
from uw_visibility.messages.processor import FrameProcessor, FrameWork, try_out, warm_up
from uw_visibility.ros.depth_check import DepthCheck
from uw_visibility.ros.inputs import RESTING, SILENCE, StereoInput
from uw_visibility.ros.monitor import OK, WARN, Finding, ReasonLog, describe_fault
from uw_visibility.ros.parameters import NodeParameters, Settings, check_qos_overrides
from uw_visibility.ros.pipeline_state import PipelineState
from uw_visibility.ros.transport.factory import make_message, message_type
from uw_visibility.ros.transport.qos import publish_on
from uw_visibility.ros.worker import NewestWorker
from uw_visibility.stereo.calibration import image_size
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.filter import WaterFilter

# A pair waits for CameraInfo of its own stamp for one to two of these, s.
CAMERA_INFO_PERIOD = 0.1
# How often the subscriptions look at their publishers, s.
QOS_PERIOD = 0.5
# How often a reason for the lack of output is repeated in the log, s.
SILENCE_PERIOD = 30.0
# Kernels are compiled once, however many cores are made meanwhile.
WARMING = threading.Lock()
# A clock that goes back by more than this was set back, s.
CLOCK_JUMP = 0.1



class NodeCore:
    """Node core, for a plain and for a managed node.

    The executor's callbacks only sort messages; the pipeline runs in the
    worker's threads, which also publish, in the order of the frames.

    Parameters
    ----------
    node : rclpy.node.Node
        Subscriptions and publishers are made on it.
    parameters : NodeParameters
        Hold the settings of the next frame.

    Attributes
    ----------
    input : StereoInput
        Knows what came in and what was dropped.
    worker : NewestWorker
        Knows what was skipped.
    state : PipelineState
        Knows what became of the frames.

    Raises
    ------
    InputError
        If a parameter that the node was started with cannot be used.
    """

    def __init__(self, node: Node, parameters: NodeParameters) -> None:
        self._node = node
        self._log = node.get_logger()
        self._parameters = parameters
        # rclpy ties a severity to the line that logs, so each log has a line of its own.
        self.state = PipelineState(ReasonLog(lambda line: self._log.error(line)))
        self._silences = ReasonLog(lambda line: self._log.warning(line), SILENCE_PERIOD)
        self._jumps = ReasonLog(lambda line: self._log.warning(line))
        self._changes = ReasonLog(lambda line: self._log.warning(line))
        self._active_since: float | None = None
        self._processor = FrameProcessor(make_message, self._settings.node.rectify)
        self._filter: WaterFilter | None = None
        self.worker = NewestWorker(self._process, self._warm_up, self._settings.node.niceness)
        # Geometry and size of the images that came last.
        self._images: tuple[StereoRig, tuple[int, int]] | None = None
        self._tried: tuple[Any, ...] = ()
        self.try_out(self._settings)
        self._publishers: dict[str, Any] = {}
        # Undoes what was made on the node, the whole or a part of it.
        with ExitStack() as made:
            self._make(made)
            self._made = made.pop_all()
        self.worker.start()

    def _make(self, made: ExitStack) -> None:
        """Make publishers, subscriptions and timers on the node."""
        node = self._node
        for topic, name in all_topics(self._settings.node).items():
            publisher = publish_on(node, message_type(name), topic)
            self._publishers[topic] = publisher
            made.callback(node.destroy_publisher, publisher)
        self.input = StereoInput(node, self._parameters, self.worker.offer, self._on_restart)
        made.callback(self.input.destroy)
        self._depth = DepthCheck(node, self._parameters)
        made.callback(self._depth.destroy)
        check_qos_overrides(node)
        # Time in the network and in the log is not that of a recording.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        for period, callback in (
            (CAMERA_INFO_PERIOD, self.input.end_wait), (QOS_PERIOD, self._update_input),
        ):
            timer = node.create_timer(period, callback, clock=clock)
            made.callback(node.destroy_timer, timer)
        backward = JumpThreshold(
            min_forward=None, min_backward=Duration(seconds=-CLOCK_JUMP), on_clock_change=False
        )
        jump = node.get_clock().create_jump_callback(
            backward, post_callback=lambda jump: self._on_clock_jump()
        )
        made.callback(jump.unregister)
        parameters = self._parameters
        parameters.try_out = self.try_out
        made.callback(setattr, parameters, "try_out", None)

    def _update_input(self) -> None:
        """Adapt the subscriptions to who publishes, and to who wants results."""
        wanted = self._depth.wanted or any(
            publisher.get_subscription_count() > 0 for publisher in self._publishers.values()
        )
        rests = self._settings.node.lazy and not wanted
        if self.input.resting and not rests and self._active_since is not None:
            self._active_since = time.monotonic()
        self.input.rest(rests)
        self.input.update_qos()

    def try_out(self, settings: Settings) -> None:
        """Try out settings on images as they come, before they are accepted.

        Parameters
        ----------
        settings : Settings
            Those of the next frame, if this passes.

        Raises
        ------
        InputError
            If no frame could be processed with them.
        """
        rig, shape = self._images or (None, None)
        config = settings.pipeline
        if shape is not None:
            check_megapixels(shape[1], shape[0], settings.node.max_megapixels)
        if self._tried == (config, rig, shape):
            return
        try_out(config, rig, shape)
        self._tried = config, rig, shape

    def activate(self) -> None:
        """Take images and publish results from now on."""
        self._active_since = time.monotonic()
        self.input.active = True

    def deactivate(self) -> None:
        """Take no image and publish no result from now on."""
        self._active_since = None
        self.input.active = False
        self.input.reset()

    def stop(self, timeout: float) -> bool:
        """End the worker; returns whether it ended within the timeout (s)."""
        self.deactivate()
        return self.worker.stop(timeout)

    def destroy(self) -> None:
        """Destroy publishers, subscriptions and timers, after `stop`."""
        self._made.close()

    def diagnose(self) -> Mapping[str, Finding]:
        """Return the findings by the part of the node; a lack of output is logged too."""
        since = self._active_since
        resting = self.input.resting and since is not None
        reason = "" if resting else self._silence()
        waited = self.state.ready and since is not None and time.monotonic() - since > SILENCE
        if reason and waited:
            self._silences.add(f"no output: {reason}")
        findings = {
            "input": self.input.diagnose(),
            "pipeline": self.state.diagnose(reason, self.worker.skipped),
            "plausibility": self._depth.diagnose(),
        }
        if since is None:
            findings["input"] = Finding(WARN, reason, findings["input"].values)
        if resting:
            for part in ("pipeline", "plausibility"):
                findings[part] = Finding(OK, RESTING, findings[part].values)
        return findings

    @property
    def _settings(self) -> Settings:
        return self._parameters.settings

    def _warm_up(self) -> None:
        with WARMING:
            if not self.worker.stopping:
                self._prepare()

    def _prepare(self) -> None:
        self._log.info(
            f"preparing the pipeline; kernels are kept in {writable_folder() or 'no folder'}, "
            "and the first start compiles them, for a minute or two"
        )
        started = time.monotonic()
        try:
            compressed = self._settings.node.image_transport == "compressed"
            warm_up(self._settings.pipeline, compressed=compressed)
        except Exception:
            if self._ending():
                # The interpreter may be on its way out.
                return
            # A frame of the real size may still work, and says why if not.
            self._log.error(f"the pipeline failed to warm up\n{traceback.format_exc()}")
        self.state.ready = True
        if self.worker.stopping:
            return
        self._log.info(
            f"ready after {time.monotonic() - started:.1f} s, {counts.compiled} kernels compiled: "
            "waiting for images"
        )

    def _process(self, frame: StereoFrame) -> None:
        """Answer a frame; whatever goes wrong costs this frame, not the node."""
        if not self._wanted():
            return
        with self.state.busy():
            try:
                self._answer(frame)
            except InputError as error:
                self.state.refuse(f"dropped a frame: {error}")
            except Exception as error:
                if self._wanted():
                    reason = f"lost a frame to {describe_fault(error)}"
                    self.state.fail(reason, f"\n{traceback.format_exc()}")

    def _answer(self, frame: StereoFrame) -> None:
        """Read a frame, run the pipeline on it, and publish what it says."""
        settings = self._settings
        begin = time.perf_counter()
        work = self._read(frame, settings)
        read = time.perf_counter()
        topics = self._wanted_topics()
        if self._filter is None or self._filter.config != settings.pipeline:
            self._filter = WaterFilter(settings.pipeline)
        result = work.assess(topics, known_light=self._filter.lamps)
        if not self._wanted():
            return
        assessed = time.perf_counter()
        filtered = self._filter.update(result.water, work.header.seconds, work.rig)
        for topic, message in work.messages(result, settings.node, topics, filtered):
            self._publishers[topic].publish(message)
        around = read - begin + time.perf_counter() - assessed
        stamp = frame.left.header.stamp
        now = self._node.get_clock().now().nanoseconds
        self.state.add(
            result, 1e-9 * (now - stamp_to_nanoseconds(stamp)), 1e3 * around, filtered)
        self._depth.add_result(stamp, result)
        if self.state.processed == 1:
            self._log.info("first frame processed")

    def _read(self, frame: StereoFrame, settings: Settings) -> FrameWork:
        """Read the images of a frame.

        Raises
        ------
        InputError
            If they cannot be used, or are larger than there may be memory for.
        """
        width, height = image_size(frame.left_info, "left")
        check_megapixels(width, height, settings.node.max_megapixels)
        work = self._processor.begin(frame, settings.pipeline)
        calibrations = self._processor.reader.calibrations
        if calibrations > max(self.state.calibrations, 1):
            self._changes.add("camera_info has changed: using the new calibration")
        self.state.calibrations = calibrations
        self._images = work.rig, (height, width)
        return work

    def _wanted(self) -> bool:
        """Return whether results are wanted, which may end while a frame is processed."""
        return self._active_since is not None and not self._ending()

    def _ending(self) -> bool:
        return self.worker.stopping or not self._node.context.ok()

    def _wanted_topics(self) -> list[str]:
        """Return the topics to publish: estimates always, images where someone listens."""
        return [
            topic for topic, publisher in self._publishers.items()
            if topic.startswith("visibility/") or publisher.get_subscription_count() > 0
        ]

    def _on_restart(self) -> None:
        """Forget the past of a recording: its stamps and its clock go back together."""
        self._jumps.add("time jumped back: starting anew from there")
        self._depth.reset()

    def _on_clock_jump(self) -> None:
        self._on_restart()
        self.input.reset()

    def _silence(self) -> str:
        """Return why there is no output, or nothing where there is."""
        if self._active_since is None:
            return "the node is not active: activate it"
        return self.state.obstacle() or self.input.silence() or self.state.silence()


def check_megapixels(width: int, height: int, most: float) -> None:
    """Refuse images of more pixels than there may be memory for.

    Raises
    ------
    InputError
        If they are larger than the parameter allows, 1e6 px.
    """
    if width * height > 1e6 * most:
        raise InputError(
            f"images have {width}x{height} pixels, more than max_megapixels, which is {most:g}: "
            "raise it where there is memory for them"
        )
