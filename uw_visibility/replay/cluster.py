# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Replay on a Dask cluster, one recording a task."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from uw_visibility.errors import InputError
from uw_visibility.replay.batch import replay_bags, settle
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.progress import Progress
from uw_visibility.replay.results.summary import Summary

# A scheduler answers at once, or is not there.
TIMEOUT = "10s"


def replay_on_cluster(
    address: str,
    targets: Mapping[Path, Path],
    options: ReplayOptions,
    *,
    force: bool = False,
    resume: bool = False,
) -> list[Summary]:
    """Replay recordings on an existing cluster.

    The workers must see recordings and folders under the same paths, and have
    this version of the package.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://10.0.0.5:8786``.
    targets, options, force, resume
        As `replay_bags` takes them.

    Returns
    -------
    list of Summary
        In the order of the recordings.

    Raises
    ------
    InputError
        If `distributed` is not installed, the scheduler cannot be reached, or
        every recording or its folder cannot be used.
    """
    try:
        # Optional: without --scheduler nothing needs it.
        distributed = importlib.import_module("distributed")
    except ImportError as error:
        raise InputError(
            "--scheduler needs distributed: install the extra distributed, "
            "pip install 'uw_visibility[distributed]'"
        ) from error
    try:
        client = distributed.Client(address, timeout=TIMEOUT)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot reach the scheduler {address}: {error}") from error
    progress = Progress("bags", len(targets))
    with client:
        futures = [
            client.submit(
                _replay_one, bag.resolve(), target.resolve(), options, force, resume, pure=False
            )
            for bag, target in targets.items()
        ]
        try:
            for _ in distributed.as_completed(futures):
                progress.add()
            return settle(targets, [_outcome(future) for future in futures])
        finally:
            client.cancel(futures)
            progress.close()


def _outcome(future: Any) -> Summary | InputError:
    """Return the outcome of a task; any error but bad input is raised here."""
    try:
        return cast(Summary, future.result())
    except InputError as error:
        return error


def _replay_one(
    bag: Path, target: Path, options: ReplayOptions, force: bool, resume: bool
) -> Any:
    """Replay one recording on whatever machine this is."""
    return replay_bags({bag: target}, options, jobs=1, force=force, resume=resume)[0]
