# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stereo input of the node: four subscriptions, the synchroniser, and their diagnostics."""

from __future__ import annotations

import functools
import itertools
import math
import statistics
import time
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from uw_visibility.messages.frames import StereoFrame
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.messages.synchronizer import SIDES, SynchronizedFrame, Synchronizer
from uw_visibility.ros.monitor import ERROR, OK, WARN, Finding, ReasonLog, RecentCounts
from uw_visibility.ros.parameters import NodeParameters
from uw_visibility.ros.transport import qos
from uw_visibility.ros.transport.qos import AdaptiveReliabilitySubscription

# Time without messages after which an input counts as stopped, s; twice its period if that is more.
SILENCE = 5.0
RECENT_DROPS = RECENT_PAIRS = 10
# Number of stamps that are remembered, relative to `queue_size`: of a camera that is later than
# the queue is long, the stamps are to be found.
REMEMBERED_QUEUES = 10
# Durability and reliability of a publisher whose last message late subscribers receive.
KEPT = DurabilityPolicy.TRANSIENT_LOCAL, ReliabilityPolicy.RELIABLE
NOT_KEPT = DurabilityPolicy.VOLATILE, ReliabilityPolicy.BEST_EFFORT
RESTING = "at rest (lazy): nobody subscribes to a result"
NO_CLOCK = "use_sim_time is true, but nothing arrives on /clock: start what publishes it"
# Largest value of synchronization.tolerance, s.
LARGEST_TOLERANCE = 1.0
# Four channels of 16 bit: larger images exceed `max_megapixels` in any encoding.
MOST_BYTES_PER_PIXEL = 8
TOO_LARGE = "larger than max_megapixels"
# Advice for images that make no stereo frame, by the reason for dropping them.
ADVICE = {
    "without a stamp": "images have no stamp: fill header.stamp with the time of exposure",
    "seen before": "images repeat a stamp: give each pair a stamp of its own",
    TOO_LARGE: "images are larger than max_megapixels: raise it where there is memory for them",
}


class StereoInput:
    """Subscriptions to images and CameraInfo, paired to stereo frames; rests until `rest(False)`.

    offer: called with each stereo frame.
    on_restart: called when the stamps jump back.
    active: whether images are accepted, see `activate`; CameraInfo always is.
    resting: whether there are no subscriptions; see `rest`.
    """

    def __init__(
        self,
        node: Node,
        parameters: NodeParameters,
        offer: Callable[[StereoFrame], None],
        on_restart: Callable[[], None],
    ) -> None:
        self.active, self.resting = False, True
        self._node = node
        self._parameters = parameters
        self._offer = offer
        self._on_restart = on_restart
        log = node.get_logger()
        self._drops = ReasonLog(lambda line: log.warning(line))
        config = parameters.settings.node.synchronization
        self.synchronizer = Synchronizer(config, self._report_drop)
        self._recent = RecentCounts(SILENCE)
        self._latest_drops: deque[str] = deque(maxlen=RECENT_DROPS)
        self._arrivals: dict[str, float] = {}
        # Times between the last two messages, s.
        self._periods: dict[str, float] = {}
        # Stamps of the images since the last frame, in the order of arrival.
        self._stamps: dict[str, deque[int]] = {side: deque() for side in SIDES}
        # Stamps of the last frames, left and right.
        self._pairs: deque[tuple[int, int]] = deque(maxlen=RECENT_PAIRS)
        self._images: dict[str, AdaptiveReliabilitySubscription] = {}
        # Images lost by the middleware, of destroyed subscriptions.
        self._lost = 0
        self._infos: dict[str, Any] = {}
        # Those that are sent once, and kept by their publishers.
        self._kept: set[str] = set()

    def destroy(self) -> None:
        while self._images:
            _, image = self._images.popitem()
            self._lost += image.lost
            image.destroy()
        while self._infos:
            self._node.destroy_subscription(self._infos.popitem()[1])

    def rest(self, resting: bool) -> None:
        """Unsubscribe if `resting`, otherwise subscribe again."""
        if resting == self.resting:
            return
        self.resting = resting
        # The CameraInfo received before is used again.
        for topic in self._images:
            self._arrivals.pop(topic, None)
        if resting:
            self.destroy()
            self.synchronizer.reset()
        else:
            self._subscribe()

    def activate(self) -> None:
        """Accept images; frames are due from now on."""
        self.active = True
        self._arrivals["frame"] = time.monotonic()

    def update_qos(self) -> None:
        """Adapt the QoS of images and CameraInfo to their publishers; called by a timer."""
        for image in self._images.values():
            image.update_qos()
        for info, present in list(self._infos.items()):
            found = qos.offered(self._node, info, CameraInfo)
            kept = all((each.durability, each.reliability) == KEPT for each in found)
            if found and kept != (info in self._kept):
                self._kept ^= {info}
                self._node.destroy_subscription(present)
                self._subscribe_to_info(info)

    def end_wait(self) -> None:
        """Release a pair whose CameraInfo does not arrive; called by a timer."""
        self._hand_on(self.synchronizer.end_wait())

    def silence(self) -> str:
        """Return why there are no stereo frames, or ""."""
        now = time.monotonic()
        for topic in self._images | self._infos:
            if topic not in self._arrivals:
                return f"no {topic} yet: {self._describe_publishers(topic)}"
        for topic in self._images:
            if now - self._arrivals[topic] > self._patience(topic):
                return f"no {topic} any more: {self._describe_publishers(topic)}"
        if now - self._arrivals.get("frame", 0.0) > self._patience(*self._images):
            return self._explain_drops()
        return ""

    def _patience(self, *topics: str) -> float:
        return max(SILENCE, *(2.0 * self._periods.get(topic, 0.0) for topic in topics))

    def _describe_publishers(self, topic: str) -> str:
        if topic in self._images:
            return self._images[topic].describe_publishers()
        return qos.describe_publishers(self._node, topic, self._infos[topic])

    def _explain_drops(self) -> str:
        """Return why the images that arrive make no stereo frames."""
        drops = " ".join(self._latest_drops)
        for reason, advice in ADVICE.items():
            if reason in drops:
                return advice
        config = self._parameters.settings.node.synchronization
        tolerance, size = config.tolerance, config.queue_size
        nanoseconds, delay = self._nearest() or (0, 0)
        gap = 1e-9 * abs(nanoseconds)
        if gap > LARGEST_TOLERANCE:
            return (
                f"left and right images have no stamps in common, the nearest are {gap:.3g} s "
                "apart: take both stamps from one clock"
            )
        # The partner of each image comes after that has left the queue.
        if abs(nanoseconds) <= round(tolerance * 1e9) and abs(delay) >= size:
            later, earlier = ("right", "left") if delay > 0 else ("left", "right")
            return (
                f"{later} images arrive {abs(delay)} images after the {earlier} ones: "
                f"raise synchronization.queue_size, which is {size}"
            )
        return (
            "left and right images have no stamps in common: "
            f"set synchronization.tolerance, which is {tolerance:g} s"
        )

    def diagnose(self) -> Finding:
        """Return level, message and values of the input."""
        now, sync = time.monotonic(), self.synchronizer
        counts = Counter(sync.received)
        counts["frames"] = sync.frames
        counts.update({f"dropped {reason}": count for reason, count in sync.dropped.items()})
        lost = self._lost + sum(image.lost for image in self._images.values())
        counts["dropped by the middleware"] = lost
        recent = self._recent.update(now, counts)
        period = max(self._recent.duration, 1e-9)
        values: dict[str, Any] = {}
        for name in ("left", "right", "left info", "right info", "frames"):
            values[f"{name} received" if name != "frames" else "stereo frames"] = counts[name]
            values[f"{name} rate (Hz)"] = f"{recent.get(name, 0) / period:.2f}"
        values["dropped images"] = sync.dropped.total()
        values["images lost by the middleware"] = lost
        values["unmatched images"] = sum(
            count for reason, count in sync.dropped.items() if "unmatched" in reason
        )
        values["waiting images"] = sync.waiting
        values["restarts"] = sync.restarts
        for name, gap in (
            ("stamp gap (s)", self._pairs[-1][0] - self._pairs[-1][1] if self._pairs else None),
            ("smallest stamp gap since (s)", nearest[0] if (nearest := self._nearest()) else None),
        ):
            values[name] = "" if gap is None else f"{1e-9 * gap:.6f}"
        for topic, image in self._images.items():
            values[f"reliability of {topic}"] = image.reliability
        for topic in self._images | self._infos:
            arrival = self._arrivals.get(topic)
            values[f"age of {topic} (s)"] = "" if arrival is None else f"{now - arrival:.1f}"
        values |= {f"dropped: {reason}": count for reason, count in sync.dropped.items()}
        return self._level(recent, period, values)

    def _level(self, recent: dict[str, int], period: float, values: dict[str, Any]) -> Finding:
        if self.resting:
            return Finding(OK, RESTING, values)
        reason = self.silence()
        if reason:
            return Finding(WARN if " yet" in reason else ERROR, reason, values)
        clock = self._node.get_clock()
        if clock.ros_time_is_active and clock.now().nanoseconds == 0:
            return Finding(WARN, NO_CLOCK, values)
        if mismatch := self._mismatch():
            return Finding(WARN, mismatch, values)
        drops = {name: count for name, count in recent.items() if name.startswith("dropped ")}
        if drops:
            worst = max(drops, key=drops.__getitem__)
            message = f"{sum(drops.values())} images in {period:.0f} s: {worst}"
            return Finding(WARN, message, values)
        rate = recent.get("frames", 0) / period
        return Finding(OK, f"{rate:.1f} stereo frames per second", values)

    def _subscribe(self) -> None:
        """Subscribe to images and CameraInfo."""
        compressed = self._parameters.settings.node.image_transport == "compressed"
        for side in SIDES:
            image = f"{side}/image_rect"
            topic, kind = image, Image
            if compressed:
                # As in image_transport, remapping applies to the name of the raw image.
                topic = f"{self._node.resolve_topic_name(image)}/compressed"
                image, kind = f"{image}/compressed", CompressedImage
            self._images[image] = AdaptiveReliabilitySubscription(
                self._node, kind, topic, functools.partial(self._on_image, side, image),
                qos.IMAGE_DEPTH,
            )
            self._subscribe_to_info(f"{side}/camera_info")

    def _subscribe_to_info(self, topic: str) -> None:
        # Best effort: CameraInfo fits into one packet, and the next one replaces a lost one.
        # A reliable subscription would hold back all messages behind a lost one, but only such a
        # one receives what was sent before, and kept.
        durability, reliability = KEPT if topic in self._kept else NOT_KEPT
        self._infos[topic] = qos.subscribe_to(
            self._node, CameraInfo, topic, functools.partial(self._on_info, topic),
            durability=durability, reliability=reliability,
        )

    def _on_image(self, side: str, topic: str, message: Any) -> None:
        self._note(topic)
        if not self.active:
            return
        settings = self._parameters.settings.node
        if len(message.data) > MOST_BYTES_PER_PIXEL * 1e6 * settings.max_megapixels:
            # Images that wait for their partner would fill the memory.
            self.synchronizer.refuse_image(side, TOO_LARGE)
            return
        stamp = stamp_to_nanoseconds(message.header.stamp)
        stamps, config = self._stamps[side], settings.synchronization
        if stamp:
            stamps.append(stamp)
        while len(stamps) > REMEMBERED_QUEUES * config.queue_size:
            stamps.popleft()
        self.synchronizer.config = config
        restarts = self.synchronizer.restarts
        frames = self.synchronizer.add_image(side, stamp, message)
        if self.synchronizer.restarts != restarts:
            self._on_restart()
        self._hand_on(frames)

    def _note(self, topic: str) -> None:
        """Note an arrival; after the first one, or the first image again, frames are due."""
        now, last = time.monotonic(), self._arrivals.get(topic)
        if last is None or (topic in self._images and now - last > SILENCE):
            self._arrivals["frame"] = now
        if last is not None:
            self._periods[topic] = now - last
        self._arrivals[topic] = now

    def _on_info(self, topic: str, message: CameraInfo) -> None:
        self._note(topic)
        side = topic.split("/")[0]
        stamp = stamp_to_nanoseconds(message.header.stamp)
        self._hand_on(self.synchronizer.add_info(side, stamp, message))

    def _hand_on(self, frames: list[SynchronizedFrame]) -> None:
        for synchronized in frames:
            self._arrivals["frame"] = time.monotonic()
            for stamps in self._stamps.values():
                stamps.clear()
            left, right, *messages = synchronized
            self._pairs.append((left, right))
            self._offer(StereoFrame(*messages))

    def _report_drop(self, reason: str) -> None:
        self._drops.add(f"dropped: {reason}")
        self._latest_drops.append(reason)

    def _mismatch(self) -> str:
        """Return that images of different moments were paired lately, or ""."""
        stamps = [left for left, _ in self._pairs]
        periods = [b - a for a, b in itertools.pairwise(stamps) if b > a]
        gap = max((abs(left - right) for left, right in self._pairs), default=0)
        # Another image of the camera was nearer: it was lost, or has another partner.
        half = statistics.median(periods) / 2 if periods else math.inf
        if gap <= half:
            return ""
        return (
            f"left and right images are paired {1e-9 * gap:.3g} s apart, more than half of "
            f"their period: trigger both cameras together, and set synchronization.tolerance "
            f"below {1e-9 * half:.3g} s"
        )

    def _nearest(self) -> tuple[int, int] | None:
        """Return the smallest gap of left and right stamps since the last frame, and the delay.

        The gap is left minus right, ns; the delay is by how many images the right one came later.
        """
        left, right = (list(self._stamps[side]) for side in SIDES)
        places = {stamp: place for place, stamp in enumerate(right, -len(right))}
        ordered = sorted(places)
        found = []
        for place, stamp in enumerate(left, -len(left)):
            index = bisect_left(ordered, stamp)
            found += [
                (stamp - other, places[other] - place)
                for other in ordered[max(index - 1, 0) : index + 1]
            ]
        return min(found, key=lambda pair: abs(pair[0]), default=None)
