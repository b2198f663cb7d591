# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Playback of a recording into the running node, at the recorded rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from uw_visibility.commands.demonstration.node_process import NodeDied
from uw_visibility.commands.demonstration.recording import RecordedFrame

if TYPE_CHECKING:
    from uw_visibility.ros.client import Collector, Player

Check = Callable[[], None]
"""Called again and again; raises where the work cannot or shall not go on."""

ANSWER = "disparity"
"""Topic that the node answers every frame with, whatever it can assess."""

START_TIMEOUT = 900.0
"""How long in s the node may take to start: it may have to compile its kernels, and not alone."""

PROBE_INTERVAL = 10.0
DRAIN_TIMEOUT = 15.0
POLL = 0.2


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
