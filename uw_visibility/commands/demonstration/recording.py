# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames of a simulated bag, with the truth, and their playing to the node at their rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uw_visibility.commands.demonstration.node_process import NodeDied
from uw_visibility.images.arrays import Array, DisparityMap, Image8
from uw_visibility.messages.images import read_disparity, read_image
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.stereo.rig import StereoRig

if TYPE_CHECKING:
    from uw_visibility.ros.client import Collector, Player

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


@dataclass(frozen=True)
class RecordedFrame:
    """Messages and truth of one instant of a bag.

    Attributes
    ----------
    time : int
        Time in the bag in ns.
    serialized : dict of str to bytes
        Message of each topic that a vehicle has.
    left, right : ndarray, shape (H, W, 3), uint8
        The images, RGB.
    rig : StereoRig
        Their geometry.
    attenuation : ndarray, shape (3,), float64
        True β in 1/m, RGB.
    mean_attenuation, depth : float
        True α in 1/m and depth in m, positive down.
    disparity : ndarray, shape (H, W), float32
        True disparity in px; NaN = open water.
    """

    time: int
    serialized: dict[str, bytes]
    left: Image8
    right: Image8
    rig: StereoRig
    attenuation: Array
    mean_attenuation: float
    depth: float
    disparity: DisparityMap


def read_recording(path: Path) -> tuple[dict[str, str], list[RecordedFrame]]:
    """Read a simulated bag.

    Parameters
    ----------
    path : Path
        Folder of a bag that `simulate` wrote.

    Returns
    -------
    topics : dict of str to str
        Type of message by topic, of those that are to be played.
    frames : list of RecordedFrame
        In the order of time.
    """
    instants: dict[int, dict[str, Any]] = {}
    with BagReader(path) as bag:
        topics = {t: name for t, name in bag.topics.items() if not t.startswith(TRUTH)}
        for recorded in bag.messages():
            instant = instants.setdefault(recorded.time, {})
            instant[recorded.topic] = (recorded.data, bag.deserialize(recorded))
    return topics, [_frame(time, instant) for time, instant in sorted(instants.items())]


def _frame(time: int, instant: dict[str, Any]) -> RecordedFrame:
    message = {topic: pair[1] for topic, pair in instant.items()}
    return RecordedFrame(
        time=time,
        serialized={t: pair[0] for t, pair in instant.items() if not t.startswith(TRUTH)},
        left=read_image(message["/left/image_rect"]),
        right=read_image(message["/right/image_rect"]),
        rig=StereoRig.from_camera_info(message["/left/camera_info"], message["/right/camera_info"]),
        attenuation=read_vector(message[TRUTH + "attenuation"]),
        mean_attenuation=message[TRUTH + "mean_attenuation"].data,
        depth=-message[TRUTH + "depth"].pose.pose.position.z,
        disparity=read_disparity(message[TRUTH + "disparity"]),
    )


def read_vector(message: Any) -> Array:
    """Return the components of a Vector3Stamped."""
    return np.array([message.vector.x, message.vector.y, message.vector.z])


def wait_until_ready(
    check: Check, player: Player, collector: Collector, probe: RecordedFrame
) -> None:
    """Wait until the node has answered a first frame, which does not count.

    Raises
    ------
    NodeDied
        If the node ends, or does not answer in time.
    """
    end = time.monotonic() + START_TIMEOUT
    while "/left/image_rect" in player.unheard() or "/right/image_rect" in player.unheard():
        _pause(check, end, "subscribed to the images")
    stamp = player.publish(probe.serialized)
    sent = time.monotonic()
    while not collector.wait(ANSWER, stamp, POLL):
        _pause(check, end, "answered a frame")
        if time.monotonic() > sent + PROBE_INTERVAL:
            # Its best-effort subscriptions may have missed the one before.
            player.publish(probe.serialized)
            sent = time.monotonic()
    # A probe sent meanwhile is answered as well, before the transect begins.
    collector.wait(ANSWER, stamp + 1, 2.0)


def play(
    check: Check,
    player: Player,
    collector: Collector,
    frames: Sequence[RecordedFrame],
    progress: Callable[[Sequence[RecordedFrame]], Iterator[Any]],
) -> list[int]:
    """Play frames at the times of the recording, and wait for the last answer.

    Returns
    -------
    list of int
        Stamp in ns that each frame was published with.

    Raises
    ------
    NodeDied
        If the node ends meanwhile.
    """
    start = time.monotonic()
    stamps = []
    for frame in progress(frames):
        due = start + (frame.time - frames[0].time) * 1e-9
        time.sleep(max(due - time.monotonic(), 0.0))
        check()
        stamps.append(player.publish(frame.serialized))
    collector.wait(ANSWER, stamps[-1], DRAIN_TIMEOUT)
    # The last frame's other messages come with it, but on topics of their own.
    time.sleep(2 * POLL)
    check()
    return stamps


def _pause(check: Check, end: float, what: str) -> None:
    check()
    if time.monotonic() > end:
        raise NodeDied(f"the node has not {what} within {START_TIMEOUT:.0f} s")
    time.sleep(POLL)
