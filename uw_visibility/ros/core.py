# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the node does: topics in, a worker thread, topics out."""

from __future__ import annotations

import functools
import time
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions
from sensor_msgs.msg import CameraInfo, Image

from uw_visibility.errors import InputError
from uw_visibility.frames import StereoFrame
from uw_visibility.outputs import TOPICS
from uw_visibility.pipeline import Pipeline
from uw_visibility.processor import FrameProcessor
from uw_visibility.ros.factory import make_message, message_type
from uw_visibility.ros.parameters import NodeParameters, Settings, check_qos_overrides
from uw_visibility.ros.reasons import ReasonLog
from uw_visibility.ros.worker import NewestWorker
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.synchronizer import SIDES, Synchronizer

OUTPUT_DEPTH = 10
# A pair waits for CameraInfo of its own stamp for one to two of these, s.
CAMERA_INFO_PERIOD = 0.1
QOS_POLICIES = (
    QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY,
)

# Kernels are compiled once per type of pixel, not per size or rig.
WARM_UP_RIG = StereoRig(500.0, 0.1, (319.5, 239.5))
WARM_UP_SHAPE = (480, 640)


class NodeCore:
    """The work of the node, on whatever kind of node it is given.

    The executor's callbacks only sort messages; the pipeline runs in the
    worker thread, which also publishes.

    Parameters
    ----------
    node : rclpy.node.Node
        Parameters, subscriptions and publishers are made on it.

    Attributes
    ----------
    parameters : NodeParameters
        Hold the settings of the next frame.
    synchronizer : Synchronizer
        Knows what came in and what was dropped.
    worker : NewestWorker
        Knows what was skipped.
    processed : int
        Frames whose results were published.
    failures : ReasonLog
        Why other frames gave no result.

    Raises
    ------
    InputError
        If a parameter that the node was started with cannot be used.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._log = node.get_logger()
        self.parameters = NodeParameters(node)
        # rclpy ties a severity to the line that logs, so each log has a line of its own.
        self.failures = ReasonLog(lambda line: self._log.error(line))
        self.processed = 0
        self._drops = ReasonLog(lambda line: self._log.warning(line))
        self._calibrations = 0
        self.synchronizer = Synchronizer(self._settings.node.synchronization, self._report_drop)
        self._processor = FrameProcessor(make_message, self._settings.node.rectify)
        self._publishers = self._create_publishers()
        self._create_subscriptions()
        check_qos_overrides(node)
        # The time that a CameraInfo takes is the network's, not the recording's.
        node.create_timer(
            CAMERA_INFO_PERIOD, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self.worker = NewestWorker(self._process, self._warm_up)
        self.worker.start()

    def stop(self, timeout: float) -> bool:
        """End the worker; returns whether it ended within the timeout (s)."""
        return self.worker.stop(timeout)

    @property
    def _settings(self) -> Settings:
        return self.parameters.settings

    def _create_publishers(self) -> dict[str, Any]:
        qos = QoSProfile(depth=OUTPUT_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
        return {
            topic: _with_overrides(
                self._node.create_publisher, message_type(name), topic, _copy(qos)
            )
            for topic, name in TOPICS.items()
        }

    def _create_subscriptions(self) -> None:
        for side in SIDES:
            for kind, topic, callback in (
                (Image, f"{side}/image_rect", self._on_image),
                (CameraInfo, f"{side}/camera_info", self._on_info),
            ):
                _with_overrides(
                    self._node.create_subscription,
                    kind, topic, functools.partial(callback, side), _copy(qos_profile_sensor_data),
                )

    def _on_image(self, side: str, message: Image) -> None:
        self.synchronizer.config = self._settings.node.synchronization
        restarts = self.synchronizer.restarts
        self._offer(self.synchronizer.add_image(side, message))
        if self.synchronizer.restarts != restarts:
            self._log.warning("stamps of the images jumped back: starting anew from there")

    def _on_info(self, side: str, message: CameraInfo) -> None:
        self._offer(self.synchronizer.add_info(side, message))

    def _on_timer(self) -> None:
        self._offer(self.synchronizer.end_wait())

    def _offer(self, frames: list[StereoFrame]) -> None:
        for frame in frames:
            self.worker.offer(frame)

    def _report_drop(self, reason: str) -> None:
        self._drops.add(f"dropped: {reason}")

    def _warm_up(self) -> None:
        self._log.info("compiling the pipeline: this takes a while at the first start only")
        started = time.monotonic()
        try:
            pipeline = Pipeline(WARM_UP_RIG, self._settings.pipeline)
            pipeline.warm_up(WARM_UP_SHAPE, np.uint8)
        except Exception:
            # A frame of the real size may still work, and says why if not.
            self._log.error(f"the pipeline failed to warm up\n{traceback.format_exc()}")
        if self.worker.stopping:
            return
        self._log.info(f"ready after {time.monotonic() - started:.1f} s: waiting for images")

    def _process(self, frame: StereoFrame) -> None:
        try:
            self._answer(frame)
        except InputError as error:
            self.failures.add(f"dropped a frame: {error}")
        except Exception as error:
            # Whatever went wrong costs this frame, not the node.
            if self.worker.stopping:
                return
            place = traceback.extract_tb(error.__traceback__)[-1]
            kind = f"{type(error).__name__} at {place.filename}:{place.lineno}"
            self.failures.add(f"lost a frame to {kind}", f"\n{traceback.format_exc()}")

    def _answer(self, frame: StereoFrame) -> None:
        settings = self._settings
        _, messages = self._processor.process(
            frame, settings.pipeline, settings.node, self._wanted_topics()
        )
        if self._processor.reader.calibrations != self._calibrations:
            self._report_calibration()
        if self.worker.stopping:
            return
        for topic, message in messages.items():
            self._publishers[topic].publish(message)
        self.processed += 1

    def _wanted_topics(self) -> list[str]:
        """Return the topics to publish: estimates always, images where someone listens."""
        return [
            topic for topic, publisher in self._publishers.items()
            if topic.startswith("visibility/") or publisher.get_subscription_count() > 0
        ]

    def _report_calibration(self) -> None:
        self._calibrations = self._processor.reader.calibrations
        if self._calibrations == 1:
            self._log.info("first frame processed")
        else:
            self._log.warning("camera_info has changed: using the new calibration")


def _with_overrides(create: Callable[..., Any], *arguments: Any) -> Any:
    """Create a publisher or subscription whose QoS can be overridden by parameters."""
    options = QoSOverridingOptions(QOS_POLICIES)
    try:
        return create(*arguments, qos_overriding_options=options)
    except (InvalidQosOverridesError, InvalidParameterTypeException, RuntimeError) as error:
        raise InputError(f"a parameter under qos_overrides cannot be used: {error}") from error


def _copy(profile: QoSProfile) -> QoSProfile:
    # Overrides are written into the profile.
    return QoSProfile(**{
        name: getattr(profile, name) for name in ("history", "depth", "reliability", "durability")
    })
