# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Faulty messages to real nodes: each is answered, or its loss counted and its reason named.

The kinds of `message_kinds` come first, in an order that the seeds of a short run sample
evenly; then messages of which a field or some bytes of the wire format are changed.
"""

from __future__ import annotations

import math
import random
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import compressed_kinds
import live
import message_kinds as kinds
from fuzz import Outcome
from mutations import mutate
from soak import spoil

# The node says how it is once a second, which is what a case would wait for.
NODE = """
import sys, warnings
warnings.simplefilter("error", RuntimeWarning)
from uw_visibility.ros import monitor
monitor.PERIOD = 0.05
from uw_visibility.ros.start import node
sys.exit(node())
"""
# Has no common divisor with the number of kinds.
STRIDE = 97
MOST_MEMORY_MIB = 1024.0
# CameraInfo comes best effort, and a message may be lost on its way.
TRIES = 3


class _Counts(NamedTuple):
    """What the node has said that it did."""

    frames: int
    processed: int
    refused: int
    dropped: int
    sensor: int
    reasons: frozenset[tuple[str, str]]


class Wire:
    """A node with its client."""

    def __init__(self, folder: Path, name: str, *arguments: str, suffix: str = "") -> None:
        parts = live.load()
        self.node = parts.NodeProcess(
            folder, "-r", f"__ns:=/{name}", "-p", "stereo.max_disparity:=40", *arguments,
            code=NODE,
        )
        self.node.wait_for("ready after", parts.READY_TIMEOUT)
        self.client = parts.Client(parts.input_topics(suffix), f"/{name}")
        self.client.wait(
            lambda: all(p.get_subscription_count() for p in self.client.publishers.values()),
            "subscriptions")
        self._stamp = 1000

    def counts(self) -> _Counts:
        """Wait until everything that came in is accounted for.

        Raises
        ------
        AssertionError
            If it is not, or something failed.
        """
        received = self.client.received["/diagnostics"]
        received.clear()
        end = time.monotonic() + 10.0
        while True:
            found = self._balanced() if len(received) > 1 else "nothing is said"
            if isinstance(found, _Counts):
                return found
            assert self.node.process.poll() is None, f"the node ended: {self.node.log[-3000:]}"
            assert time.monotonic() < end, found
            time.sleep(0.01)

    def _balanced(self) -> _Counts | str:
        given, done, sensor, callbacks = (
            dict(self.client.diagnosis(part).numbers)
            for part in ("input", "pipeline", "plausibility", "callbacks")
        )
        if not (given and done and callbacks):
            return "nothing is said"
        frames = int(given["stereo frames"])
        outcomes = {
            name: int(done[f"frames {name}"])
            for name in ("processed", "refused", "failed", "skipped")
        }
        assert outcomes["failed"] == 0, self.node.log[-3000:]
        assert callbacks["failed callbacks"] == "0", self.node.log[-3000:]
        images = int(given["left received"]) + int(given["right received"])
        dropped, waiting = int(given["dropped images"]), int(given["waiting images"])
        if sum(outcomes.values()) != frames or images != 2 * frames + dropped + waiting:
            return f"of {images} images {dropped} dropped, {waiting} wait; {frames}: {outcomes}"
        reasons = frozenset(
            item for part in (given, done) for item in part.items()
            if item[0].startswith(("dropped: ", "problem: "))
        )
        return _Counts(
            frames, outcomes["processed"], outcomes["refused"], dropped,
            int(sensor.get("refused sensor messages", 0)), reasons,
        )

    def send(self, frame: dict[str, Any]) -> None:
        """Publish messages, or their bytes, CameraInfo first."""
        for topic in sorted(frame, key=lambda name: "image" in name):
            publisher = self.client.publishers[topic]
            publisher.publish(frame[topic])

    def stamped(self, frame: dict[str, Any]) -> int:
        """Give a frame the next stamp; returns it, s."""
        self._stamp += 1
        for topic, message in frame.items():
            message.header.stamp.sec, message.header.stamp.nanosec = self._stamp, 5
            message.header.frame_id = topic.partition("/")[0]
        return self._stamp

    def close(self) -> None:
        """End the node; raises where it does not end well."""
        code, _ = self.node.stop(signal.SIGTERM)
        self.client.close()
        assert (code, "Traceback" in self.node.log) == (0, False), self.node.log[-3000:]

    def answered(self, frame: dict[str, Any], tries: int = TRIES) -> None:
        """Publish a good frame until it is answered: a bad one before may take its place."""
        for _ in range(tries):
            stamp = self.stamped(frame)
            self.send(frame)
            end = time.monotonic() + 5.0
            while time.monotonic() < end:
                if self.client.has("disparity", stamp):
                    return
                time.sleep(0.005)
        raise AssertionError(f"a good frame had no answer: {self.node.log[-3000:]}")


class Cases:
    """Messages of all kinds; two nodes, one of them for compressed images."""

    case = ""

    def __init__(self, folder: Path) -> None:
        from uw_visibility.messages.images import ENCODINGS

        parts = live.load()
        scene = parts.make_scene()
        self._views = scene.left, scene.right
        self._parts = parts
        self._nodes = {
            "raw": Wire(folder, "raw"),
            "compressed": Wire(
                folder, "compressed", "-p", "image_transport:=compressed", suffix="/compressed"
            ),
        }
        self._sensor = self._nodes["raw"].client.node.create_publisher(
            self._pose_type(), "depth_sensor", 10
        )
        for name, wire in self._nodes.items():
            wire.answered(self._frame(name), 100)
        image = parts.image_message
        self._kinds: list[tuple[str, Any]] = [
            ("raw", kind) for generated in (
                kinds.image_kinds(list(ENCODINGS), image, self._views),
                kinds.pair_kinds(image, self._views), kinds.info_kinds(), kinds.header_kinds(),
                kinds.sensor_kinds(),
            ) for kind in generated
        ]
        self._kinds += [
            ("compressed", kind) for kind in compressed_kinds.compressed_kinds(self._views)
        ]
        assert math.gcd(STRIDE, len(self._kinds)) == 1

    @staticmethod
    def _pose_type() -> Any:
        from geometry_msgs.msg import PoseWithCovarianceStamped

        return PoseWithCovarianceStamped

    def _frame(self, node: str) -> dict[str, Any]:
        """Make the messages of a good frame."""
        frame: dict[str, Any] = {}
        for side, pixels in zip(live.SIDES, self._views, strict=True):
            frame[f"{side}/camera_info"] = self._parts.info_message(side)
            frame[f"{side}/image"] = self._parts.image_message(pixels, "rgb8")
            if node == "compressed":
                frame[f"{side}/image"] = compressed_kinds.compressed_message(pixels)
        return frame

    def run(self, seed: int) -> Outcome:
        """Send a faulty frame and a good one, and hold the node to what it says of them."""
        rng = random.Random(seed)
        if seed < len(self._kinds) or rng.random() < 0.3:
            node, kind = self._kinds[seed * STRIDE % len(self._kinds)]
            self.case = f"{node}: {kind.name}"
            act = self._sense if isinstance(kind, kinds.SensorKind) else self._replace
            return self._tried(self._nodes[node], lambda: act(self._nodes[node], node, kind))
        node = rng.choice(sorted(self._nodes))
        spoils = rng.random() < 0.5
        act = self._spoil if spoils else self._mutate
        return self._tried(
            self._nodes[node], lambda: act(self._nodes[node], node, random.Random(seed))
        )

    def close(self) -> None:
        """End the nodes; raises where they do not end well."""
        for wire in self._nodes.values():
            wire.close()

    def _tried(self, wire: Wire, act: Callable[[], Outcome]) -> Outcome:
        for left in reversed(range(TRIES)):
            outcome = act()
            if outcome.verdict in ("read", "refused") or not left:
                break
        memory = wire.node.memory
        if memory > MOST_MEMORY_MIB:
            return outcome._replace(verdict=f"{memory:.0f} MiB")
        return outcome

    def _replace(self, wire: Wire, node: str, kind: kinds.MessageKind) -> Outcome:
        """Send a frame of a kind."""
        before = wire.counts()
        frame = self._frame(node)
        wire.stamped(frame)
        kind.change(frame)
        wire.send(frame)
        stamps = {
            frame[t].header.stamp.sec for t in ("left/image", "right/image") if t in frame}
        if kind.says == kinds.ANSWERED:
            # The newest frame takes the place of one that waits.
            self._wait_for(lambda: any(wire.client.has("disparity", s) for s in stamps))
        else:
            time.sleep(0.02)
        wire.answered(self._frame(node))
        after = wire.counts()
        lost = after.refused - before.refused + after.dropped - before.dropped
        if not lost:
            answered = after.processed - before.processed == 2
            good = kind.says in (kinds.ANSWERED, ".*")
            return Outcome(self.case, "read" if answered and good else "not noticed", str(after))
        new = [name for name, count in after.reasons - before.reasons]
        named = any(re.search(kind.says, name) for name in new) and kind.says != kinds.ANSWERED
        return Outcome(self.case, "refused" if named else "wrong reason", str(new)[:500])

    def _sense(self, wire: Wire, node: str, kind: kinds.SensorKind) -> Outcome:
        """Send a depth that no sensor measures."""
        before = wire.counts()
        message = self._pose_type()()
        message.header.stamp.sec = 1 if kind.stamped else 0
        message.pose.pose.position.z = kind.z
        message.pose.covariance[14] = kind.variance
        self._sensor.publish(message)
        self._wait_for(lambda: wire.counts().sensor > before.sensor)
        said = wire.client.diagnosis("plausibility").message
        good = wire.counts().sensor == before.sensor + 1 and kind.says in said
        return Outcome(self.case, "refused" if good else "wrong reason", said)

    def _spoil(self, wire: Wire, node: str, rng: random.Random) -> Outcome:
        """Set fields of a frame to values that their types allow."""
        before = wire.counts()
        frame = self._frame(node)
        wire.stamped(frame)
        spoiled = [rng.choice(sorted(frame)) for _ in range(rng.choice((1, 1, 1, 2, 4)))]
        self.case = f"{node}: " + ", ".join(
            f"{topic} {spoil(frame[topic], rng)}" for topic in spoiled)
        wire.send(frame)
        return self._recovered(wire, node, before)

    def _mutate(self, wire: Wire, node: str, rng: random.Random) -> Outcome:
        """Change bytes of a message as it is sent."""
        from rclpy.serialization import serialize_message

        before = wire.counts()
        frame = self._frame(node)
        wire.stamped(frame)
        topic = rng.choice(sorted(frame))
        data = serialize_message(frame[topic])
        # Where names, sizes and lengths are; the rest is pixels.
        head = data[:150] if "image" in topic else data
        what, head = mutate(head, rng)
        self.case = f"{node}: {topic} {what} in the first {len(head)} bytes"
        frame[topic] = head + data[150:] if "image" in topic else head
        wire.send(frame)
        return self._recovered(wire, node, before)

    def _recovered(self, wire: Wire, node: str, before: _Counts) -> Outcome:
        time.sleep(0.02)
        wire.answered(self._frame(node))
        after = wire.counts()
        lost = after.refused - before.refused + after.dropped - before.dropped
        named = after.reasons - before.reasons
        if lost and not named:
            return Outcome(self.case, "no reason", str(after))
        return Outcome(self.case, "refused" if lost else "read", str(sorted(named))[:500])

    @staticmethod
    def _wait_for(done: Callable[[], bool]) -> None:
        end = time.monotonic() + 3.0
        while not done() and time.monotonic() < end:
            time.sleep(0.005)
