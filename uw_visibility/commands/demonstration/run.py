# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstration from end to end: simulate, run the node, play, compare, draw."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import numpy as np

from uw_visibility.commands.demonstration import comparison, recording
from uw_visibility.commands.demonstration.comparison import FrameComparison
from uw_visibility.commands.demonstration.figures import draw_frame, draw_series
from uw_visibility.commands.demonstration.node_process import NodeProcess, isolate, reserved_domain
from uw_visibility.commands.demonstration.recording import Check, RecordedFrame
from uw_visibility.commands.progress import progress_bar, tell
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.messages.images import read_disparity, read_image
from uw_visibility.messages.outputs import TOPICS
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.simulation.bag import write_transect
from uw_visibility.simulation.transect import Transect

Item = TypeVar("Item")

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

PICTURES = 4
"""Frames that are drawn, evenly spread over the transect."""


@dataclass(frozen=True)
class Answer:
    """Messages that the node answered one frame with.

    Attributes
    ----------
    messages : dict of str to object
        Message by topic; empty where the node did not answer.
    latency : float
        From the stamp to the arrival of the last of them in ms.
    """

    messages: Mapping[str, Any]
    latency: float


class Interruption:
    """Signal handlers that only note the signal; to be used in a ``with`` statement.

    An exception raised by a signal's handler can come up in a callback of the
    compiler or of the middleware, which swallows it. So the handler only takes
    a note, and the work asks for it between two frames. A second signal does
    not wait that long.
    """

    def __init__(self) -> None:
        self._asked = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruption:
        self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal has come."""
        if self._asked:
            raise KeyboardInterrupt

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True

    def __exit__(self, *details: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


def demonstrate(folder: Path, transect: Transect) -> list[tuple[str, str]]:
    """Run the demonstration.

    Parameters
    ----------
    folder : Path
        Where the recording, the pictures, the table and the node's log go.
    transect : Transect
        What to simulate.

    Returns
    -------
    list of tuple of two str
        Names and values of the summary.

    Raises
    ------
    NodeDied
        If the node ends before its time.
    InputError
        If the recording cannot be written, or no ROS domain is free.
    KeyboardInterrupt
        After a signal that asks for the end.
    """
    isolate(folder / "fastdds.xml")
    bag = folder / "transect"
    with (
        reserved_domain() as domain, Interruption() as interruption,
        NodeProcess(folder / "node.log", domain) as node,
    ):

        def check() -> None:
            interruption.check()
            node.check()

        # The node compiles its kernels while the transect is being simulated.
        write_transect(
            bag, transect, overwrite=True,
            progress=lambda frames: _checked(frames, "simulate", transect.frames, check),
        )
        topics, frames = recording.read_recording(bag)
        answers = _ask(check, domain, topics, frames)
    with Interruption() as interruption:
        rows = _compare(folder, frames, answers, interruption.check)
    draw_series(folder / "series.png", rows)
    comparison.write_csv(folder / "frames.csv", rows)
    return comparison.summarize(rows)


def _checked(
    items: Iterable[Item], name: str, total: int, check: Check
) -> Iterator[Item]:
    """Yield items with a progress bar, as long as the check finds no objection."""
    for item in progress_bar(items, name, total):
        check()
        yield item


def _compare(
    folder: Path, frames: Sequence[RecordedFrame], answers: Sequence[Answer], check: Check
) -> list[FrameComparison]:
    """Compare the answers with the truth, and draw some of them."""
    # The raw pairs are matched here, by the pipeline's own matcher.
    pipeline = Pipeline(frames[0].rig)
    pictured = set(np.linspace(0, len(frames) - 1, PICTURES).round().astype(int).tolist())
    # An earlier run's may be of other frames.
    for picture in folder.glob("frame_[0-9][0-9][0-9].png"):
        picture.unlink()
    rows = []
    pairs = zip(frames, answers, strict=True)
    for index, (frame, answer) in enumerate(_checked(pairs, "compare", len(frames), check)):
        before = pipeline.process(frame.left, frame.right, match_original=True).stereo.original
        assert before is not None
        seconds = (frame.time - frames[0].time) * 1e-9
        row = comparison.compare(frame, seconds, answer.messages, answer.latency, before)
        rows.append(row)
        if index in pictured and row.answered:
            _draw(folder / f"frame_{index:03d}.png", frame, answer, before, row)
    return rows


def _ask(
    check: Check, domain: int, topics: Mapping[str, str], frames: Sequence[RecordedFrame]
) -> list[Answer]:
    """Play the frames into the node and return its answer to each."""
    from uw_visibility.ros.client import open_link

    with open_link(domain, topics, TOPICS) as (player, collector):
        tell("waiting for the node to be ready")
        recording.wait_until_ready(check, player, collector, frames[0])
        stamps = recording.play(
            check, player, collector, frames,
            lambda items: progress_bar(items, "play", len(items)),
        )
        by_stamp = collector.by_stamp()
        answers = []
        for stamp in stamps:
            arrivals = by_stamp.get(stamp, {})
            last = max((arrival.time for arrival in arrivals.values()), default=None)
            answers.append(Answer(
                {topic: collector.read(topic, a) for topic, a in arrivals.items()},
                comparison.NAN if last is None else (last - stamp) * 1e-6,
            ))
    return answers


def _draw(
    path: Path, frame: RecordedFrame, answer: Answer, before: DisparityMap,
    row: FrameComparison,
) -> None:
    if not {"left/enhanced/image", "disparity"} <= answer.messages.keys():
        return
    enhanced = read_image(answer.messages["left/enhanced/image"])
    after = read_disparity(answer.messages["disparity"])
    draw_frame(path, (frame.left, enhanced), (before, after, frame.disparity), row)
