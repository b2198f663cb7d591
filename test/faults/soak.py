# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Endurance of the node: good and bad pairs for a time, and what it has grown by then.

    python test/faults/soak.py [--minutes M] [--seed S] [-o FILE]

Between good pairs come damaged ones, depths that cannot be, parameters that cannot work, and
subscribers that come and go. Passes where the node lives, answers the good pairs, accounts for
every frame, fails in no callback, and where memory, descriptors and threads do not grow after
the start. `make soak` takes half an hour.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import live
import numpy as np

# What belongs to the start: a share of the time, and never more than this, s.
START_SHARE, LONGEST_START = 0.3, 120.0
# How much may come on top of it.
MOST_MEMORY_MIB, MOST_DESCRIPTORS, MOST_THREADS = 10.0, 4, 2
# How long what has come in may take to be accounted for, on a busy machine, s.
SETTLED_TIMEOUT = 30.0
# Memory at any time, MiB.
MEMORY_LIMIT_MIB = 1024.0
# Pairs per second, of which one in so many is good.
RATE, GOOD_EVERY = 10.0, 4
ABSURD_NUMBERS = (0, 1, 7, 255, 65535, 2**31 - 1, 2**32 - 1)
ABSURD_VALUES = (0.0, -1.0, 1e-300, 1e300, -1e300, math.nan, math.inf, -math.inf)
ABSURD_TEXTS = ("", "\x1b[2J\n[INFO] forged", "x" * 100_000, "\u202e\u0000", "rgb8", "32FC1")


class Sample(NamedTuple):
    """What the node's process had at a time."""

    time: float
    memory: float
    descriptors: int
    threads: int


def sample(process: int, now: float) -> Sample:
    """Read memory (MiB), descriptors and threads of a process."""
    status = Path(f"/proc/{process}/status").read_text()
    fields = dict(line.split(":", 1) for line in status.splitlines() if ":" in line)
    descriptors = len(list(Path(f"/proc/{process}/fd").iterdir()))
    return Sample(
        now, int(fields["VmRSS"].split()[0]) / 1024, descriptors, int(fields["Threads"])
    )


def spoil(message: Any, rng: random.Random, depth: int = 0) -> str:
    """Set one field of a message, at any depth, to a value that its type allows; returns which."""
    fields = message.get_fields_and_field_types()
    name = rng.choice(sorted(fields))
    value = getattr(message, name)
    if hasattr(value, "get_fields_and_field_types") and depth < 4:
        return f"{name}.{spoil(value, rng, depth + 1)}"
    kind = fields[name]
    if kind == "string":
        new: Any = rng.choice(ABSURD_TEXTS)
        new = new.replace("\0", "")
    elif "double" in kind or "float" in kind:
        new = rng.choice(ABSURD_VALUES)
        if "[" in kind or "sequence" in kind:
            changed = np.array(value, np.float64)
            if changed.size:
                changed[rng.randrange(changed.size)] = new
            new = changed if "[" in kind else list(changed)
    elif "sequence" in kind:
        new = value[: rng.randrange(len(value) + 1)]
    elif kind == "boolean":
        new = not value
    else:
        bits = int("".join(c for c in kind if c.isdigit()) or 8)
        largest = 2 ** (bits - (not kind.startswith("u"))) - 1
        new = min(rng.choice(ABSURD_NUMBERS), largest)
    setattr(message, name, new)
    return name


class Soak:
    """A node under load and its client.

    Parameters
    ----------
    folder : Path
        For the node's log.
    seed : int
        Of what is done.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        self._parts = live.load()
        self.node = self._parts.NodeProcess(
            folder, "-r", "__ns:=/soak", "-p", "stereo.max_disparity:=40",
            "-p", "publish_points:=true", "-p", "publish_depth_image:=true",
        )
        self.node.wait_for("ready after", self._parts.READY_TIMEOUT)
        self._rng = random.Random(seed)
        self._scene = self._parts.double(self._parts.make_scene())
        self.client = self._parts.Client(self._parts.input_topics(), "/soak")
        from geometry_msgs.msg import PoseWithCovarianceStamped

        self._sensor = self.client.node.create_publisher(
            PoseWithCovarianceStamped, "depth_sensor", 10
        )
        self._pose = PoseWithCovarianceStamped
        self.good = self.bad = self.answered = 0
        self._stamp = 1000

    def pair(self, pixels: Callable[[np.ndarray], np.ndarray] = np.asarray) -> list[Any]:
        """Make the messages of a good pair, its images changed as told."""
        images = [pixels(p) for p in (self._scene.left, self._scene.right)]
        return [
            *(self._parts.image_message(p, "rgb8") for p in images),
            *(self._parts.info_message(side, scale=2) for side in ("left", "right")),
        ]

    def step(self) -> None:
        """Publish a pair, good or bad, and do now and then something else."""
        rng = self._rng
        self._stamp += 1
        if (self.good + self.bad) % GOOD_EVERY == 0:
            self.good += 1
            self.client.publish(*self.pair(), stamp=self._stamp)
        else:
            self.bad += 1
            rng.choice((self._spoiled, self._spoiled, self._spoiled, self._odd, self._unpaired))()
        if rng.random() < 0.3:
            self._sense()
        if rng.random() < 0.05:
            rng.choice((self._set_parameter, self._come_and_go))()

    def _spoiled(self) -> None:
        messages = self.pair()
        # Stamps are set when the client publishes.
        for _ in range(rng_count(self._rng)):
            spoil(self._rng.choice(messages), self._rng)
        self.client.publish(*messages, stamp=self._stamp)

    def _odd(self) -> None:
        pixels = self._rng.choice([
            np.zeros_like, lambda p: np.full_like(p, 255), lambda p: p[::-1].copy(),
            lambda p: np.random.default_rng(self._stamp).integers(0, 256, p.shape, np.uint8),
            lambda p: p // 16,
        ])
        stamp = self._rng.choice([self._stamp, self._stamp, self._stamp - 3, 1, 2**31 - 1])
        self.client.publish(*self.pair(pixels), stamp=stamp)

    def _unpaired(self) -> None:
        messages = dict(zip(
            ("left/image", "right/image", "left/camera_info", "right/camera_info"), self.pair(),
            strict=True,
        ))
        for name in self._rng.sample(sorted(messages), 3):
            messages[name].header.stamp.sec = self._rng.choice([0, self._stamp])
            self.client.publishers[name].publish(messages[name])

    def _sense(self) -> None:
        message = self._pose()
        message.header.stamp.sec = self._stamp
        message.pose.pose.position.z = self._rng.choice((-4.0, -4.1, *ABSURD_VALUES))
        message.pose.covariance[14] = self._rng.choice((0.01, 0.0, *ABSURD_VALUES))
        self._sensor.publish(message)

    def _set_parameter(self) -> None:
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        name, value = self._rng.choice([
            ("camera.flat_field", "/none.png"), ("stereo.min_disparity", 900), ("depth_frame", ""),
            ("max_range", math.nan), ("enhancement.max_gain", 20.0), ("enhancement.max_gain", 30.0),
            ("stereo.max_disparity", 40), ("stereo.max_disparity", 48), ("no.such", 1),
        ])
        parameters = [Parameter(name, value=value).to_parameter_msg()]
        self.client.call("uw_visibility/set_parameters", SetParameters.Request(
            parameters=parameters
        ))

    def _come_and_go(self) -> None:
        topic = self._rng.choice(["disparity", "points2", "left/enhanced/image"])
        self.client.forget(topic)
        time.sleep(0.05)
        self.client.listen(topic)

    def collect(self) -> dict[str, dict[str, str]]:
        """Count and drop what has come back; returns the newest diagnostics' numbers by part."""
        received = self.client.received
        self.answered += len(received["visibility/raw/distance"])
        numbers = {
            part: dict(self.client.diagnosis(part).numbers)
            for part in ("input", "pipeline", "callbacks")
        }
        for messages in received.values():
            messages.clear()
        return numbers

    def settle(self) -> dict[str, dict[str, str]]:
        """Publish a good pair, wait for its answer, and return the diagnostics after it."""
        self._stamp += 10
        self.client.connect(*self.pair())
        end = time.monotonic() + SETTLED_TIMEOUT
        while True:
            # Until what is said is of after the answer, and a frame that waited has its turn.
            time.sleep(3.0)
            numbers = self.collect()
            if (all(numbers.values()) and balanced(numbers)) or time.monotonic() > end:
                return numbers


def balanced(numbers: dict[str, dict[str, str]]) -> bool:
    """Return whether every frame that went in is accounted for."""
    return sum(outcomes(numbers).values()) == int(numbers["input"]["stereo frames"])


def outcomes(numbers: dict[str, dict[str, str]]) -> dict[str, int]:
    """Return what became of the frames."""
    return {
        name: int(numbers["pipeline"][f"frames {name}"])
        for name in ("processed", "refused", "failed", "skipped")
    }


def rng_count(rng: random.Random) -> int:
    """Return a number of faults: mostly one."""
    return rng.choice((1, 1, 1, 2, 5))


def growth(samples: list[Sample], start: float) -> dict[str, float]:
    """Return what the last fifth of the samples has more than the first after the start."""
    rest = [s for s in samples if s.time >= start]
    part = max(len(rest) // 5, 1)
    return {
        name: statistics.median(getattr(s, name) for s in rest[-part:])
        - statistics.median(getattr(s, name) for s in rest[:part])
        for name in ("memory", "descriptors", "threads")
    }


def course(samples: list[Sample], parts: int = 10) -> list[dict[str, float]]:
    """Return the medians of tenths of the time, for a table."""
    end = samples[-1].time
    found = []
    for part in range(parts):
        low, high = end * part / parts, end * (part + 1) / parts
        within = [s for s in samples if low <= s.time <= high]
        if within:
            found.append({"until (min)": round(high / 60.0, 1)} | {
                name: round(statistics.median(getattr(s, name) for s in within), 1)
                for name in ("memory", "descriptors", "threads")
            })
    return found


def run(minutes: float, seed: int) -> dict[str, Any]:
    """Run for a time; returns what came of it, with the faults that were found."""
    with tempfile.TemporaryDirectory() as folder:
        soak = Soak(Path(folder), seed)
        process = soak.node.process
        begin = time.monotonic()
        samples: list[Sample] = []
        while (now := time.monotonic() - begin) < 60.0 * minutes and process.poll() is None:
            soak.step()
            if not samples or now - samples[-1].time >= 1.0:
                samples.append(sample(process.pid, now))
                soak.collect()
            time.sleep(max((soak.good + soak.bad) / RATE - (time.monotonic() - begin), 0.0))
        alive = process.poll() is None
        numbers = soak.settle() if alive else {}
        code = soak.node.stop(signal.SIGTERM)[0] if alive else process.returncode
        soak.client.close()
        log = soak.node.log
    start = min(START_SHARE * 60.0 * minutes, LONGEST_START)
    grown = growth(samples, start)
    return {
        "minutes": minutes, "seed": seed, "good pairs": soak.good, "bad pairs": soak.bad,
        "frames with a distance": soak.answered, "exit code": code,
        "peak memory (MiB)": round(max(s.memory for s in samples), 1),
        "growth of memory (MiB)": round(grown["memory"], 1),
        "growth of descriptors": grown["descriptors"], "growth of threads": grown["threads"],
        "course": course(samples),
        "faults": faults(numbers, log, code, grown, samples),
    }


def faults(
    numbers: dict[str, dict[str, str]], log: str, code: int, grown: dict[str, float],
    samples: list[Sample],
) -> list[str]:
    """Return what must not be, in sentences."""
    found = []
    if code != 0:
        found.append(f"the node ended with {code}: {log[-2000:]}")
    if "Traceback" in log:
        found.append(f"a traceback: {log[log.index('Traceback'):][:2000]}")
    if numbers:
        done = outcomes(numbers)
        if not balanced(numbers):
            frames = numbers["input"]["stereo frames"]
            found.append(f"{frames} frames went in, and {done} are accounted for")
        if done["failed"]:
            found.append(f"{done['failed']} frames were lost to errors inside")
        if numbers["callbacks"]["failed callbacks"] != "0":
            found.append(f"callbacks failed: {numbers['callbacks']}")
    for name, limit in (
        ("memory", MOST_MEMORY_MIB), ("descriptors", MOST_DESCRIPTORS), ("threads", MOST_THREADS),
    ):
        if grown[name] > limit:
            found.append(f"{name} grew by {grown[name]:g}, more than {limit:g}")
    if max(s.memory for s in samples) > MEMORY_LIMIT_MIB:
        found.append(f"memory went beyond {MEMORY_LIMIT_MIB:g} MiB")
    return found


def main() -> int:
    """Run, print the result as JSON; returns 1 where there are faults."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, help="file for the result")
    options = parser.parse_args()
    text = json.dumps(run(options.minutes, options.seed), indent=2)
    print(text)
    if options.output is not None:
        options.output.write_text(text + "\n", encoding="utf-8")
    return 1 if json.loads(text)["faults"] else 0


if __name__ == "__main__":
    sys.exit(main())
