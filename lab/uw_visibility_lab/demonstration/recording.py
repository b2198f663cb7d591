# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames of a simulated bag, with the truth, and their playing to the node at their rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from uw_visibility.images.arrays import Array, DisparityMap, Image8
from uw_visibility.messages.images import read_disparity, read_image
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.stereo.rig import StereoRig
from uw_visibility_lab.demonstration.node_process import NodeDied

if TYPE_CHECKING:
    from uw_visibility_lab.demonstration.client import Collector, Player

TRUTH = "/ground_truth/"
Check = Callable[[], None]
"""Called again and again; raises where the work cannot or shall not go on."""

ANSWER = "disparity"
"""Topic that the node answers every frame with, whatever it can assess."""

START_TIMEOUT = 900.0
"""How long in s the node may take to start: it may have to compile its kernels, and not alone."""

PROBE_INTERVAL = 10.0
DRAIN_TIMEOUT = 15.0
POLL = 0.2


class RecordedFrame(NamedTuple):
    """Messages and truth of one instant of a bag."""

    time: int  # in the bag, ns
    serialized: dict[str, bytes]  # message of each topic that a vehicle has
    left: Image8
    right: Image8
    rig: StereoRig
    attenuation: Array  # true β in 1/m, RGB
    mean_attenuation: float  # true α in 1/m
    depth: float  # true, m, positive down
    disparity: DisparityMap  # true, px; NaN = open water


class Answer(NamedTuple):
    """Messages that the node answered one frame with."""

    messages: Mapping[str, Any]  # by topic; empty where the node did not answer
    latency: float  # from the stamp to the arrival of the last of them in ms


def read_recording(path: Path) -> tuple[dict[str, str], list[RecordedFrame]]:
    """Read a simulated bag: types of the topics that are to be played, and frames in turn."""
    instants: dict[int, dict[str, Any]] = {}
    with BagReader(path) as bag:
        topics = {t: name for t, name in bag.topics.items() if not t.startswith(TRUTH)}
        for recorded in bag.messages():
            instant = instants.setdefault(recorded.time, {})
            instant[recorded.topic] = (recorded.data, bag.deserialize(recorded))
    return topics, [_frame(time, instant) for time, instant in sorted(instants.items())]


def _frame(time: int, instant: dict[str, Any]) -> RecordedFrame:
    message = {topic: pair[1] for topic, pair in instant.items()}
    beta = message[TRUTH + "attenuation"].vector
    return RecordedFrame(
        time=time,
        serialized={t: pair[0] for t, pair in instant.items() if not t.startswith(TRUTH)},
        left=read_image(message["/left/image_rect"]),
        right=read_image(message["/right/image_rect"]),
        rig=StereoRig.from_camera_info(message["/left/camera_info"], message["/right/camera_info"]),
        attenuation=np.array([beta.x, beta.y, beta.z]),
        mean_attenuation=message[TRUTH + "mean_attenuation"].data,
        depth=-message[TRUTH + "depth"].pose.pose.position.z,
        disparity=read_disparity(message[TRUTH + "disparity"]),
    )


def wait_until_ready(
    check: Check, player: Player, collector: Collector, probe: RecordedFrame
) -> None:
    """Wait until the node has answered a first frame, which does not count."""
    end = time.monotonic() + START_TIMEOUT

    def go_on(what: str) -> None:
        check()
        if time.monotonic() > end:
            raise NodeDied(f"the node has not {what} within {START_TIMEOUT:.0f} s")

    while {"/left/image_rect", "/right/image_rect"} & set(player.unheard()):
        go_on("subscribed to the images")
        time.sleep(POLL)
    stamp = player.publish(probe.serialized)
    sent = time.monotonic()
    while not collector.wait(ANSWER, stamp, POLL):
        go_on("answered a frame")
        if time.monotonic() > sent + PROBE_INTERVAL:
            # Its best-effort subscriptions may have missed the one before.
            player.publish(probe.serialized)
            sent = time.monotonic()
    # A probe sent meanwhile is answered as well, before the transect begins.
    collector.wait(ANSWER, stamp + 1, 2.0)


def play(
    check: Check, player: Player, collector: Collector, frames: Sequence[RecordedFrame],
    shown: Iterable[RecordedFrame],
) -> list[Answer]:
    """Play frames (`shown` with a progress bar) at their times; return the node's answers."""
    start = time.monotonic()
    stamps = []
    for frame in shown:
        due = start + (frame.time - frames[0].time) * 1e-9
        time.sleep(max(due - time.monotonic(), 0.0))
        check()
        stamps.append(player.publish(frame.serialized))
    collector.wait(ANSWER, stamps[-1], DRAIN_TIMEOUT)
    # The last frame's other messages come with it, but on topics of their own.
    time.sleep(2 * POLL)
    check()
    by_stamp = collector.by_stamp()
    answers = []
    for stamp in stamps:
        arrivals = by_stamp.get(stamp, {})
        last = max((arrival.time for arrival in arrivals.values()), default=None)
        answers.append(Answer(
            {topic: collector.read(topic, a) for topic, a in arrivals.items()},
            float("nan") if last is None else (last - stamp) * 1e-6))
    return answers
