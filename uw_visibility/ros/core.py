# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Node core: subscriptions, worker threads, publishers and diagnostics."""

from __future__ import annotations

import math
import threading
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from operator import attrgetter
from typing import Any

from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node

from uw_visibility.compute.jit import counts
from uw_visibility.compute.kernel_folder import writable_folder
from uw_visibility.config.assumptions import ASK_TRANSFER, like_video
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.images.network import NetworkError, digests
from uw_visibility.messages.depth_sensor import SENSOR_TYPES, read_depth
from uw_visibility.messages.estimates import NIS_TOPICS, nis_messages
from uw_visibility.messages.frames import StereoFrame
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.messages.outputs import all_topics
from uw_visibility.messages.processor import FrameProcessor, FrameWork, try_out, warm_up
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.plausibility.comparison import Comparison, DepthSample, Report, Verdict
from uw_visibility.plausibility.monitor import NO_SENSOR, OTHER_STAMPS, DepthMonitor
from uw_visibility.ros.inputs import RESTING, SILENCE, StereoInput
from uw_visibility.ros.monitor import (
    ERROR,
    OK,
    STALE,
    WARN,
    Finding,
    ReasonLog,
    RecentCounts,
    describe_fault,
)
from uw_visibility.ros.parameters import NodeParameters, Settings, check_qos_overrides
from uw_visibility.ros.transport.factory import make_message, message_type
from uw_visibility.ros.transport.qos import describe_publishers, publish_on, subscribe_to
from uw_visibility.ros.worker import NewestWorker, Turn
from uw_visibility.status import Status
from uw_visibility.stereo.calibration import CameraCalibration, doubt, image_size
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.series.filter import FilteredWater, KnownWater, WaterFilter

# A pair waits one to two of these periods for the CameraInfo with its stamp, s.
CAMERA_INFO_PERIOD = 0.1
# Period at which the subscriptions adapt to their publishers, s.
QOS_PERIOD = 0.5
# Period at which the log repeats why there is no output, s.
SILENCE_PERIOD = 30.0
# Only one core compiles kernels at a time.
WARMING = threading.Lock()
# Smallest backward jump of the clock that resets the state, s.
CLOCK_JUMP = 0.1
# Failures of a network in a row, after which the built-in parts replace it.
MOST_FAILURES = 3


class NodeCore:
    """Core of the plain and of the managed node.

    The executor's callbacks only pair messages. The worker's threads run the
    pipeline and publish the results in the order of the frames.
    """

    def __init__(self, node: Node, parameters: NodeParameters) -> None:
        self._node = node
        self._log = node.get_logger()
        self._parameters = parameters
        # rclpy refuses a second severity from the same source line: one lambda for each log.
        self.state = PipelineState(ReasonLog(lambda line: self._log.error(line)))
        self._silences = ReasonLog(lambda line: self._log.warning(line), SILENCE_PERIOD)
        self._jumps = ReasonLog(lambda line: self._log.warning(line))
        self._changes = ReasonLog(lambda line: self._log.warning(line))
        self._active_since: float | None = None
        self._processor = FrameProcessor(make_message, self._settings.node.rectify)
        self._filter: WaterFilter | None = None
        self._filtering = threading.Lock()
        node_settings = self._settings.node
        self.worker = NewestWorker(
            self._process, self._warm_up, node_settings.niceness, node_settings.frames_at_once)
        # Rig and size (height, width), px, of the last images.
        self._images: tuple[StereoRig, tuple[int, int]] | None = None
        self._tried: tuple[Any, ...] = ()
        self.try_out(self._settings)
        self._publishers: dict[str, Any] = {}
        # Destroys what was created on the node, also if `_make` fails halfway.
        with ExitStack() as made:
            self._make(made)
            self._made = made.pop_all()
        self.worker.start()

    def _make(self, made: ExitStack) -> None:
        """Create publishers, subscriptions and timers on the node."""
        node = self._node
        for topic, name in all_topics(self._settings.node).items():
            publisher = publish_on(node, message_type(name), topic)
            self._publishers[topic] = publisher
            made.callback(node.destroy_publisher, publisher)
        self.input = StereoInput(node, self._parameters, self.worker.offer, self._on_restart)
        made.callback(self.input.destroy)
        self.input.rest(False)
        self._depth = DepthCheck(node, self._parameters, made)
        check_qos_overrides(node)
        # Steady clock: these periods do not follow simulated time.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        for period, callback in (
            (CAMERA_INFO_PERIOD, self.input.end_wait), (QOS_PERIOD, self._update_input),
        ):
            timer = node.create_timer(period, callback, clock=clock)
            made.callback(node.destroy_timer, timer)
        backward = JumpThreshold(
            min_forward=None, min_backward=Duration(seconds=-CLOCK_JUMP), on_clock_change=False
        )
        jump = node.get_clock().create_jump_callback(backward, post_callback=self._on_clock_jump)
        made.callback(jump.unregister)
        self._parameters.try_out = self.try_out
        made.callback(setattr, self._parameters, "try_out", None)

    def _update_input(self) -> None:
        """Adapt QoS to the publishers; unsubscribe while a lazy node has no subscribers."""
        wanted = self._depth.wanted or any(
            publisher.get_subscription_count() > 0 for publisher in self._publishers.values()
        )
        rests = self._settings.node.lazy and not wanted
        if self.input.resting and not rests and self._active_since is not None:
            self._active_since = time.monotonic()
        self.input.rest(rests)
        self.input.update_qos()

    def try_out(self, settings: Settings) -> None:
        """Refuse settings that do not work with the size and calibration of the last images."""
        rig, shape = self._images or (None, None)
        config = settings.pipeline
        if shape is not None:
            check_megapixels(shape[1], shape[0], settings.node.max_megapixels)
        if self._tried == (config, rig, shape):
            return
        try_out(config, rig, shape)
        self._tried = config, rig, shape
        self.state.models = digests(config)

    def activate(self) -> None:
        """Start to accept images and to publish results."""
        self._active_since = time.monotonic()
        self.input.activate()

    def deactivate(self) -> None:
        """Stop accepting images and publishing results."""
        self._active_since = None
        self.input.active = False
        self.input.synchronizer.reset()

    def stop(self, timeout: float) -> bool:
        """Stop the worker; return whether it ended within the timeout (s)."""
        self.deactivate()
        return self.worker.stop(timeout)

    def destroy(self) -> None:
        """Destroy publishers, subscriptions and timers, after `stop`."""
        self._made.close()

    def diagnose(self) -> Mapping[str, Finding]:
        """Return the findings by part of the node; log a lack of output, too."""
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
            # Somebody wants it so: no part has failed.
            findings = {part: Finding(WARN, reason, f.values) for part, f in findings.items()}
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
                # The interpreter may be shutting down.
                return
            # Real frames may still work; if not, their errors are reported.
            self._log.error(f"the pipeline failed to warm up\n{traceback.format_exc()}")
        self.state.ready = True
        if self.worker.stopping:
            return
        self._log.info(
            f"ready after {time.monotonic() - started:.1f} s, {counts.compiled} kernels compiled: "
            "waiting for images"
        )

    def _process(self, frame: StereoFrame, turn: Turn) -> None:
        """Process a frame; an error loses this frame only and is reported."""
        if not self._wanted():
            self.state.discard()
            return
        pipeline = self._settings.pipeline
        # Networks use threads of their own, and memory may not suffice for two at once.
        built_in = pipeline.built_in() == pipeline
        self.worker.lanes = self._settings.node.frames_at_once if built_in else 1
        with self.state.busy():
            try:
                self._run_pipeline(frame, turn)
            except NetworkError as error:
                turn.wait()
                if self.state.substitute.fail(error) and self._wanted():
                    self._log.error(self.state.substitute.reason)
                self.state.fail(f"lost a frame: {error}", "")
            except InputError as error:
                turn.wait()
                self.state.refuse(f"dropped a frame: {error}")
            except Exception as error:
                turn.wait()
                if self._wanted():
                    reason = f"lost a frame to {describe_fault(error)}"
                    self.state.fail(reason, f"\n{traceback.format_exc()}")
                else:
                    self.state.discard()

    def _run_pipeline(self, frame: StereoFrame, turn: Turn) -> None:
        """Read a frame, run the pipeline, and publish the results in the order of the frames."""
        settings = self._settings
        begin = time.perf_counter()
        work = self._read(
            frame, settings, self.state.substitute.config(settings.pipeline), turn.lane)
        read = time.perf_counter()
        # Estimates are always published, other topics only with subscribers.
        topics = [
            topic for topic, publisher in self._publishers.items()
            if topic.startswith("visibility/") or publisher.get_subscription_count() > 0
        ]
        with self._filtering:
            known_light = self._filter_for(settings).lamps

        def known_water() -> KnownWater | None:
            # The filter needs all earlier frames, which other lanes may still process.
            turn.wait()
            with self._filtering:
                return self._filter_for(settings).known

        result = work.assess(topics, known_light=known_light, known_water=known_water)
        turn.wait()
        self.state.substitute.succeed()
        if not self._wanted():
            self.state.discard()
            return
        assessed = time.perf_counter()
        with self._filtering:
            filtered = self._filter_for(settings).update(
                result.water, work.header.seconds, work.pair.rig)
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
            if "camera.transfer" not in self._parameters.told and like_video(frame.left):
                self._log.warning(ASK_TRANSFER)

    def _filter_for(self, settings: Settings) -> WaterFilter:
        """Return the filter; it is a new one after a change of parameters."""
        if self._filter is None or self._filter.config != settings.pipeline:
            self._filter = WaterFilter(settings.pipeline)
        return self._filter

    def _read(
        self, frame: StereoFrame, settings: Settings, pipeline: PipelineConfig, lane: int
    ) -> FrameWork:
        # Either may be the larger one; that they differ is said when both are read.
        sizes = [image_size(frame.left_info, "left"), image_size(frame.right_info, "right")]
        for size in sizes:
            check_megapixels(*size, settings.node.max_megapixels)
        work = self._processor.begin(frame, pipeline, lane)
        calibrations = self._processor.reader.calibrations
        if calibrations > max(self.state.calibrations, 1):
            self._changes.add("camera_info has changed: using the new calibration")
        if calibrations > self.state.calibrations:
            for info, side in ((frame.left_info, "left"), (frame.right_info, "right")):
                calibration = CameraCalibration.from_camera_info(info, side)
                if why := doubt(info, calibration, side):
                    self._changes.add(why)
        self.state.calibrations = calibrations
        width, height = sizes[0]
        self._images = work.pair.rig, (height, width)
        return work

    def _wanted(self) -> bool:
        """Return whether to publish; the node may be deactivated while a frame is processed."""
        return self._active_since is not None and not self._ending()

    def _ending(self) -> bool:
        return self.worker.stopping or not self._node.context.ok()

    def _on_restart(self) -> None:
        """Reset the depth check after a jump back in time, of the stamps or of the clock."""
        self._jumps.add("time jumped back: continuing from the new time")
        self._depth.reset()

    def _on_clock_jump(self, jump: Any) -> None:
        self._on_restart()
        self.input.synchronizer.restart(self._node.get_clock().now().nanoseconds)

    def _silence(self) -> str:
        """Return the reason for a lack of output, or ""."""
        if self._active_since is None:
            return "the node is not active: activate it"
        return self.state.obstacle() or self.input.silence() or self.state.silence()


def check_megapixels(width: int, height: int, most: float) -> None:
    """Refuse images of more than `most` megapixels, to limit memory."""
    if width * height > 1e6 * most:
        raise InputError(
            f"images have {width}x{height} pixels, more than max_megapixels, which is {most:g}: "
            "raise it where there is memory for them"
        )


class Substitute:
    """Fallback to the built-in matcher and restorer after repeated failures of a network.

    Replay has no fallback, since results of a frame must not depend on failures of earlier ones.

    reason: why the built-in parts are in use; "" if they are not.
    """

    def __init__(self) -> None:
        self.reason = ""
        self._failures = 0
        self._wanted: PipelineConfig | None = None

    def config(self, wanted: PipelineConfig) -> PipelineConfig:
        """Return the configuration to use; a change of parameters ends the fallback."""
        if wanted != self._wanted:
            self._wanted, self._failures, self.reason = wanted, 0, ""
        return wanted.built_in() if self.reason else wanted

    def fail(self, error: NetworkError) -> bool:
        """Count a lost frame; return whether the fallback begins with it."""
        self._failures += 1
        if self._failures < MOST_FAILURES or self.reason:
            return False
        self.reason = (
            f"a network failed {MOST_FAILURES} times in a row, and the built-in matcher and "
            f"restorer stand in until a parameter changes: {error}")
        return True

    def succeed(self) -> None:
        """Reset the count of failures, after a frame that was processed."""
        self._failures = 0


class PipelineState:
    """Counts frames by their outcome; written by the worker, read by the diagnostics.

    processed, refused, failed, discarded: numbers of frames with published results, with unusable
        input, lost to internal errors, and paired before the node was deactivated.
    calibrations: changes of the calibration, including the first one.
    failures: log of the reasons why frames gave no result.
    models: SHA-256 of the networks in use, by name of parameter.
    substitute: fallback to the built-in parts if these fail.
    """

    def __init__(self, failures: ReasonLog) -> None:
        self.ready = False
        self.processed = self.refused = self.failed = self.discarded = 0
        self.calibrations = 0
        self.failures = failures
        self._recent = RecentCounts(SILENCE)
        self._lock = threading.Lock()
        # Start times of the frames in process, s.
        self._begun: list[float] = []
        self._answered = 0.0
        self._problem = ""
        self._result: FrameResult | None = None
        self._filtered: FilteredWater | None = None
        self._latency = self._around = 0.0
        self.models: dict[str, str] = {}
        self.substitute = Substitute()

    @contextmanager
    def busy(self) -> Iterator[None]:
        begun = time.monotonic()
        with self._lock:
            self._begun.append(begun)
        try:
            yield
        finally:
            with self._lock:
                self._begun.remove(begun)

    def add(
        self, result: FrameResult, latency: float, around: float,
        filtered: FilteredWater | None = None,
    ) -> None:
        """Count a frame whose result was published.

        latency: time since the image's stamp, s.
        around: time for reading the images and publishing the messages, ms.
        """
        with self._lock:
            self._result, self._latency, self._problem = result, latency, ""
            self._around, self._filtered = around, filtered
            self._answered = time.monotonic()
            self.processed += 1

    def refuse(self, reason: str) -> None:
        """Count a frame with unusable input."""
        with self._lock:
            self._problem = reason
            self.failures.add(reason)
            self.refused += 1

    def fail(self, reason: str, details: str) -> None:
        """Count a frame that was lost to an internal error."""
        with self._lock:
            self._problem = reason
            self.failures.add(reason, details)
            self.failed += 1

    def discard(self) -> None:
        """Count a frame whose result is not wanted any more."""
        with self._lock:
            self.discarded += 1

    def obstacle(self) -> str:
        """Return the reason why no frame is processed, or ""."""
        if not self.ready:
            return f"the pipeline is being compiled, kernels so far: {counts.compiled}"
        with self._lock:
            busy = min(self._begun, default=math.inf)
        if time.monotonic() - busy > SILENCE:
            return "the pipeline is still busy with one frame"
        return ""

    def silence(self) -> str:
        """Return why incoming frames give no results, or ""."""
        if time.monotonic() - self._answered <= SILENCE:
            return ""
        # After a pause of the input, its first frame may still be in process.
        return self._problem or ("" if self.processed else "no frame was processed yet")

    def diagnose(self, silence: str, skipped: int) -> Finding:
        counts = {
            "processed": self.processed, "refused": self.refused, "failed": self.failed,
            "skipped": skipped, "discarded (not active)": self.discarded,
        }
        recent = self._recent.update(time.monotonic(), counts)
        rate = recent.get("processed", 0) / max(self._recent.duration, 1e-9)
        values: dict[str, Any] = {f"frames {name}": count for name, count in counts.items()}
        values["rate (Hz)"] = f"{rate:.2f}"
        values["calibrations"] = self.calibrations
        values |= self.models
        if self._result is not None:
            values |= _values(self._result, self._filtered)
            values["around the pipeline (ms)"] = f"{self._around:.1f}"
            values["latency (ms)"] = f"{1e3 * self._latency:.1f}"
        values |= self.failures.problems()
        if silence:
            stopped = self.processed > 0 or self.refused + self.failed > 0
            return Finding(ERROR if stopped else WARN, f"no output: {silence}", values)
        if self.substitute.reason:
            return Finding(ERROR, self.substitute.reason, values)
        missing = self._missing()
        if recent.get("refused") or recent.get("failed"):
            level = ERROR if recent.get("failed") else WARN
            latest = next(iter(self.failures.problems(1))).removeprefix("problem: ")
            lost = "; ".join(filter(None, (missing, f"lately {latest}")))
            return Finding(level, self._problem or lost, values)
        survey = self._filtered.survey if self._filtered is not None else None
        if survey is not None:
            return Finding(OK, f"{rate:.1f} frames per second; water of a survey: {survey}", values)
        if missing:
            return Finding(WARN, missing, values)
        text = f"{rate:.1f} frames per second"
        share = recent.get("skipped", 0) / max(sum(recent.values()), 1)
        if share > 0.5:
            return Finding(
                WARN, f"{text}, {share:.0%} of the frames are skipped: lower the camera's rate, or "
                "set stereo.reduction", values)
        return Finding(OK, text, values)

    def _missing(self) -> str:
        """Return which estimate of the last frame is not assessable, and why; "" if none."""
        if self._result is None:
            return ""
        status, distance = self._result.status, self._result.visibility.status
        if status is not Status.OK:
            return f"the water is not assessable: {status}"
        if distance is not Status.OK:
            return f"the visibility distance is not assessable: {distance}"
        return ""


def _values(result: FrameResult, filtered: FilteredWater | None) -> dict[str, Any]:
    """Return the diagnostic values of a frame and of the filter, by name."""
    values: dict[str, Any] = {
        "status": result.status,
        "visibility status": result.visibility.status,
        "depth status": result.visibility.depth_status,
        "support points": result.stereo.support_points,
        "coverage": f"{result.stereo.coverage:.3f}",
        "matched fraction": f"{result.stereo.matched_fraction:.3f}",
    }
    values |= {f"{stage} (ms)": f"{duration:.1f}" for stage, duration in result.timing_ms.items()}
    if filtered is not None:
        values |= {
            "filter": filtered.event,
            "rejected by the filter": f"{filtered.rejected} of {filtered.assessed} frames",
            "rejected by the filter in a row": filtered.rejected_in_a_row,
            "survey": filtered.survey or "none",
        }
    return values


SENSOR_TOPIC = "depth_sensor"
# Parameters by which the depth that a message means changes.
MEANING = attrgetter("sensor_sign", "sensor_offset", "density", "surface_pressure")

LEVELS = {
    Verdict.OK: OK, Verdict.WARN: WARN, Verdict.ERROR: ERROR,
    Verdict.STALE: STALE, Verdict.NOT_ASSESSABLE: WARN,
}


class DepthCheck:
    """Plausibility test of the depth sensor; the sensor's callback and the worker call it."""

    def __init__(self, node: Node, parameters: NodeParameters, made: ExitStack) -> None:
        self._node = node
        self._parameters = parameters
        self._monitor = DepthMonitor(parameters.settings.node.plausibility)
        self._learned_with = self._terms()
        self._lock = threading.Lock()
        log = node.get_logger()
        self._refusals = ReasonLog(lambda line: log.warning(line))
        self._verdicts = ReasonLog(lambda line: log.warning(line))
        self._refused: tuple[float, str] | None = None
        self._subscription: Any = None
        self._publishers: dict[str, Any] = {}
        for topic, name in NIS_TOPICS.items():
            publisher = self._publishers[topic] = publish_on(node, message_type(name), topic)
            made.callback(node.destroy_publisher, publisher)
        kind = parameters.settings.node.plausibility.sensor_type
        if kind in SENSOR_TYPES:
            self._subscription = subscribe_to(
                node, message_type(SENSOR_TYPES[kind]), SENSOR_TOPIC, self._on_sensor
            )
            made.callback(node.destroy_subscription, self._subscription)

    @property
    def wanted(self) -> bool:
        """Whether its topics have a subscriber."""
        publishers = self._publishers.values()
        return any(publisher.get_subscription_count() > 0 for publisher in publishers)

    def reset(self) -> None:
        """Discard all samples, after a jump of time."""
        with self._lock:
            self._monitor.reset()

    def add_result(self, stamp: Any, result: FrameResult) -> None:
        """Compare the estimated depth at an image's stamp."""
        if self._subscription is None:
            return
        visibility = result.visibility
        sample = DepthSample.estimated(
            stamp_to_nanoseconds(stamp), visibility.depth, visibility.depth_stddev,
            visibility.depth_precision,
        )
        with self._lock:
            comparisons = self._updated_monitor().add_estimate(
                sample, visibility.depth_status, time.monotonic()
            )
        self._publish(comparisons)

    def diagnose(self) -> Finding:
        if self._subscription is None:
            return Finding(OK, "switched off: plausibility.sensor_type is none")
        now = time.monotonic()
        with self._lock:
            report = self._updated_monitor().report(now)
        values = _report_values(report) | {"refused sensor messages": self._refusals.total}
        refused, timeout = self._refused, self._monitor.config.timeout
        if refused is not None and now - refused[0] <= timeout:
            return Finding(WARN, refused[1], values)
        if report.verdict in (Verdict.WARN, Verdict.ERROR):
            self._verdicts.add(
                f"depth sensor and estimate do not agree ({report.verdict})", f": {report.reason}"
            )
        topic = self._subscription.topic_name
        if report.reason == NO_SENSOR and not self._node.count_publishers(topic):
            return Finding(OK, f"no sensor: nobody publishes {topic}", values)
        message = f"{report.verdict}: {report.reason}"
        # Values arrive where only their stamps do not fit.
        if report.reason.startswith("no depth_sensor") and report.reason != OTHER_STAMPS:
            message += ", " + describe_publishers(
                self._node, SENSOR_TOPIC, self._subscription, "set plausibility.sensor_type")
        return Finding(LEVELS[report.verdict], message, values)

    def _on_sensor(self, message: Any) -> None:
        config = self._parameters.settings.node.plausibility
        try:
            sample = read_depth(message, config, self._node.get_clock().now().nanoseconds)
        except InputError as error:
            self._refused = time.monotonic(), str(error)
            self._refusals.add(str(error))
            return
        with self._lock:
            comparisons = self._updated_monitor().add_sensor(sample, time.monotonic())
        self._publish(comparisons)

    def _updated_monitor(self) -> DepthMonitor:
        self._monitor.config = self._parameters.settings.node.plausibility
        terms = self._terms()
        if terms != self._learned_with:
            self._learned_with = terms
            self._monitor.reset()
        return self._monitor

    def _terms(self) -> tuple[Any, ...]:
        """Return what the learned bias holds for, such as white reference and sensor's offset."""
        settings = self._parameters.settings
        return settings.pipeline, *MEANING(settings.node.plausibility)

    def _publish(self, comparisons: list[Comparison]) -> None:
        frame = self._parameters.settings.node.depth_frame
        for comparison in comparisons:
            for topic, message in nis_messages(make_message, comparison, frame):
                self._publishers[topic].publish(message)


def _report_values(report: Report) -> dict[str, Any]:
    values: dict[str, Any] = {
        "verdict": report.verdict,
        "comparisons": report.compared,
        "beyond the gate": report.failed,
        "evidence of a fault (s)": f"{report.evidence:.4g}",
        "too uncertain to judge": report.inconclusive,
        "estimates without a sensor value": report.unmatched,
        "sensor values with a repeated or older stamp": report.repeated,
        "learned bias (m)": _number(report.bias),
        "learned bias stddev (m)": _number(report.bias_stddev),
    }
    last = report.last
    if last is not None:
        values |= {
            "estimated depth (m)": _number(last.estimate.depth),
            "estimated depth stddev (m)": _number(last.estimate.depth_stddev),
            "sensor depth (m)": _number(last.sensor.depth),
            "sensor depth stddev (m)": _number(last.sensor.depth_stddev),
            "innovation (m)": _number(last.innovation),
            "innovation variance (m^2)": _number(last.variance),
            "nis": _number(last.nis),
            "gate (m)": _number(last.gate),
        }
    return values


def _number(value: float) -> str:
    # NaN is shown as empty text.
    return f"{value:.4f}" if value == value else ""
