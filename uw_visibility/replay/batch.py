# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings one after the other, their frames side by side."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from uw_visibility.replay.options import ReplayOptions
from uw_visibility.replay.pool import FramePool
from uw_visibility.replay.runner import Summary, replay_bag


def replay_bags(
    targets: Mapping[Path, Path],
    options: ReplayOptions,
    *,
    jobs: int = 1,
    force: bool = False,
    resume: bool = False,
) -> list[Summary]:
    """Replay recordings into folders.

    Parameters
    ----------
    targets : mapping of Path to Path
        Folder to make, by recording.
    options : ReplayOptions
        What is wanted.
    jobs : int
        Processes that work on frames. The results do not depend on it.
    force, resume : bool
        Whether existing results are replaced, or partial ones gone on from.

    Returns
    -------
    list of Summary
        One for each recording.

    Raises
    ------
    InputError
        If a recording or a folder cannot be used.
    """
    with FramePool(jobs, options.pipeline) as pool:
        return [
            replay_bag(bag, target, options, pool, force=force, resume=resume)
            for bag, target in targets.items()
        ]
