# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstration from end to end: simulate, run the node, play, compare, draw."""

from __future__ import annotations

import itertools
import signal
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TypeVar

import numpy as np

from uw_visibility.config.files import Products, gathered
from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.outputs import all_topics
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.progress import progress_bar, tell
from uw_visibility.stereo.rig import StereoRig
from uw_visibility_lab.demonstration import comparison
from uw_visibility_lab.demonstration.client import (
    Answer,
    Check,
    open_link,
    play,
    wait_until_ready,
)
from uw_visibility_lab.demonstration.comparison import Row, Truth
from uw_visibility_lab.demonstration.node_process import NodeProcess, isolate, reserved_domain
from uw_visibility_lab.simulation.bag import write_transect
from uw_visibility_lab.simulation.new_bag import check_bag
from uw_visibility_lab.simulation.transect import Transect, TransectFrame

Item = TypeVar("Item")

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

STAMPED = {
    topic: kind for topic, kind in all_topics(NodeConfig()).items()
    if kind != "std_msgs/msg/Float64"}
"""Type of message by topic, of messages with a stamp."""

TRUTH = "/ground_truth/"
"""Prefix of topics that a vehicle does not have."""

PICTURES = 4
"""Number of frames that are drawn, evenly spread over the transect."""

LOG_TITLE = "The node of uw_visibility demo"
LOG = Products("node.log", (), "not of a demonstration", keys=(LOG_TITLE,))
RESULTS = Products(
    "frames.csv", ("series.png", "frame_[0-9][0-9][0-9].png"), "not of a demonstration",
    keys=("true_mean_attenuation",))


def demonstrate(folder: Path, transect: Transect, *, force: bool = False) -> dict[str, str]:
    """Run the demonstration; write to the folder, return the summary's values by name.

    With `force` the results of an earlier demonstration are replaced.
    """
    bag = folder / "transect"
    for products in (LOG, RESULTS):
        products.check_room(folder, force=force)
    check_bag(bag, force)
    truths: list[Truth] = []

    def keep(rendered: TransectFrame) -> TransectFrame:
        time, frame = rendered
        truths.append(Truth(
            time, frame.left, frame.right, frame.attenuation, frame.mean_attenuation, frame.depth,
            frame.disparity_left))
        return rendered

    isolate()
    log = folder / LOG.mark
    log.write_text(f"{LOG_TITLE}\n", encoding="utf-8")
    with (
        reserved_domain() as domain, noted_signals() as interrupted,
        NodeProcess(log, domain) as node,
    ):

        def check() -> None:
            interrupted()
            node.check()

        # The node compiles its kernels while the transect is being simulated.
        write_transect(
            bag, transect, overwrite=True,
            progress=lambda frames: map(keep, _checked(frames, "simulate", transect.frames, check)),
        )
        topics, played = _read(bag)
        with open_link(domain, topics, STAMPED) as (player, collector):
            tell("waiting for the node to be ready")
            wait_until_ready(check, player, collector, played[0])
            timed = zip([truth.time for truth in truths], played, strict=True)
            answers = play(check, player, collector, progress_bar(timed, "play", len(played)))
    with gathered(folder, RESULTS, force=force) as work:
        with noted_signals() as interrupted:
            rows = _compare(work, transect.camera.rig, truths, answers, interrupted)
        comparison.write_results(work, rows)
    return comparison.summarize(rows)


@contextmanager
def noted_signals() -> Iterator[Check]:
    """Record termination signals; the check that it yields raises KeyboardInterrupt after one.

    The compiler and the middleware swallow exceptions that a signal handler raises in their
    callbacks. So the check is called between two frames. A second signal raises at once.
    """
    asked = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    def check() -> None:
        if asked:
            raise KeyboardInterrupt

    before = {number: signal.signal(number, note) for number in SIGNALS}
    try:
        yield check
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _checked(items: Iterable[Item], name: str, total: int, check: Check) -> Iterator[Item]:
    """Yield items with a progress bar, and check before each."""
    for item in progress_bar(items, name, total):
        check()
        yield item


def _read(bag: Path) -> tuple[dict[str, str], list[dict[str, bytes]]]:
    """Return the types of a vehicle's topics, and their messages, grouped by time."""
    with BagReader(bag) as reader:
        topics = {t: kind for t, kind in reader.topics.items() if not t.startswith(TRUTH)}
        instants = itertools.groupby(reader.messages(topics), key=lambda recorded: recorded.time)
        return topics, [{one.topic: one.data for one in some} for _, some in instants]


def _compare(
    folder: Path, rig: StereoRig, truths: Sequence[Truth], answers: Sequence[Answer], check: Check
) -> list[Row]:
    """Compare the answers with the truth, and draw some of them."""
    # The raw pairs are matched here, by the pipeline's own matcher.
    pipeline = Pipeline(rig)
    pictured = set(np.linspace(0, len(truths) - 1, PICTURES).round().astype(int).tolist())
    rows = []
    pairs = zip(truths, answers, strict=True)
    for index, (frame, answer) in enumerate(_checked(pairs, "compare", len(truths), check)):
        before = pipeline.process(frame.left, frame.right, match_original=True).stereo.original
        assert before is not None
        row = comparison.compare(frame, answer, before)
        rows.append(row)
        if index in pictured and {"left/enhanced/image", "disparity"} <= answer.messages.keys():
            path = folder / f"frame_{index:03d}.png"
            comparison.draw_frame(path, frame.left, answer.messages, rig, row)
    return rows
