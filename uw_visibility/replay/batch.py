# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Batch replay: recordings one after the other, their frames in parallel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from uw_visibility import __version__
from uw_visibility.errors import InputError, printable
from uw_visibility.replay import stores
from uw_visibility.replay.bags.layout import find_files
from uw_visibility.replay.inputs.lacks import check_in_any
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.pool import FramePool, frame_pool
from uw_visibility.replay.progress import MakeCounter, Progress
from uw_visibility.replay.report.sentences import verdict
from uw_visibility.replay.results.folder import MARK
from uw_visibility.replay.results.provenance import Origin
from uw_visibility.replay.results.summary import Summary
from uw_visibility.replay.runner import replay_bag
from uw_visibility.replay.stores import Place


def replay_bags(
    targets: Mapping[Place, Place],
    options: ReplayOptions,
    *,
    jobs: int = 1,
    force: bool = False,
    resume: bool = False,
    counter: MakeCounter = Progress,
) -> list[Summary]:
    """Replay recordings into folders.

    Parameters
    ----------
    targets : mapping of (Path or str) to (Path or str)
        Folder to make, by recording; each a path, or a URL that fsspec knows.
    options : ReplayOptions
        What is wanted.
    jobs : int
        Processes that work on frames. The results do not depend on it.
    force, resume : bool
        Whether existing results are replaced, or partial ones gone on from and
        complete ones left as they are.
    counter : callable
        Makes what counts a recording's frames.

    Returns
    -------
    list of Summary
        One for each recording.

    Raises
    ------
    InputError
        If a folder or every recording cannot be used, or no recording has a topic to
        join. Of several recordings, one that cannot be used holds up no other: its
        summary says why, and what a recording lacks of the topics to join.
    """
    options = replace(options, several=options.several or len(targets) > 1)
    finished = {
        bag: _finished(bag, target, options) if resume and not force else None
        for bag, target in targets.items()
    }
    # What is finished was made with the same topics, and to look for them may be to fetch.
    if len(targets) > 1 and not any(finished.values()):
        check_in_any(targets, options)
    for bag, target in targets.items():
        # Before hours of work on the others, not after.
        if finished[bag] is None:
            stores.check_place(target, force)
    with frame_pool(jobs, options.pipeline) as pool:
        outcomes: list[Summary | InputError] = []
        for bag, target in targets.items():
            try:
                outcomes.append(finished[bag] or _replay(
                    bag, target, options, pool, force=force, resume=resume, counter=counter,
                ))
            except InputError as error:
                outcomes.append(error)
            except (MemoryError, OSError):
                raise
            except Exception as error:
                # Whatever is wrong here, it costs this recording, not a night of others.
                if not options.several:
                    raise
                outcomes.append(_internal(error))
    return settle(targets, outcomes)


def _internal(error: Exception) -> InputError:
    """Return what is told of an error inside that costs a recording its result."""
    reason = printable(" ".join(str(error).split()))
    return InputError(
        f"internal error, {type(error).__name__}: {reason} (replay it alone with --debug, which "
        "shows where)")


def settle(
    targets: Mapping[Place, Place], outcomes: Sequence[Summary | InputError]
) -> list[Summary]:
    """Return a summary for each recording, if there is a result of any.

    Parameters
    ----------
    targets : mapping of (Path or str) to (Path or str)
        Folder by recording.
    outcomes : sequence of Summary or InputError
        What became of each.

    Raises
    ------
    InputError
        The first one, if there is nothing else.
    """
    summaries = []
    for (bag, target), outcome in zip(targets.items(), outcomes, strict=True):
        if isinstance(outcome, InputError):
            if all(isinstance(other, InputError) for other in outcomes):
                raise outcome
            outcome = Summary(str(bag), str(target), error=str(outcome))
        summaries.append(outcome)
    return summaries


def _replay(
    bag: Place, target: Place, options: ReplayOptions, pool: FramePool, **how: Any
) -> Summary:
    """Replay a recording from where it is to where its result shall be."""
    with stores.recording_here(bag) as recording, stores.result_here(target) as folder:
        summary = replay_bag(recording, folder, options, pool, **how)
    return replace(summary, bag=str(bag), output=str(target))


def _finished(bag: Place, target: Place, options: ReplayOptions) -> Summary | None:
    """Return the summary of a result that is there already, complete and made alike.

    Raises
    ------
    InputError
        If it was made otherwise, saying what differs.
    """
    try:
        state = stores.read_state_at(target)
    except (OSError, ValueError):
        return None
    if not state.get("complete"):
        return None
    if isinstance(bag, str):
        # To compare the recording would be to fetch it.
        origin = Origin(bag, str(state.get("fingerprint")), __version__, options.parameters())
    else:
        origin = Origin.of(bag, find_files(bag).files, options.parameters())
    difference = origin.difference(state)
    if not difference and state.get("extras") != options.extras():
        difference = (
            "was made with another choice of --images, --video, --geo, --netcdf, --parquet, "
            "--all-topics")
    if difference:
        raise InputError(
            f"{target} exists already and {difference}: give another name, or --force to replace"
        )
    try:
        summary = Summary.of_finished(str(bag), str(target), state)
        # What is told of it at the end needs more of the state than its form.
        for tell in (
            summary.rejections, summary.surveyed, summary.refusals.together,
            lambda: verdict(summary),
        ):
            tell()
        return summary
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{stores.child(target, MARK)} is damaged: give another name, or --force to replace "
            "the result"
        ) from error
