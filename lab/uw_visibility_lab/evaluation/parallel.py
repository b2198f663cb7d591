# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parallel map over pieces of work, in this process or in several."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import cv2

from uw_visibility.compute.processes import process_pool
from uw_visibility.compute.threads import number_of_threads

Progress = Callable[[Iterator[Any], int], Iterator[Any]]
"""Takes an iterator over results and their number, and yields the results."""


def run_all(
    function: Callable[[Any], Any], pieces: Sequence[Any], jobs: int, progress: Progress
) -> list[Any]:
    """Apply a function to pieces of work; the result is the same for any number of jobs.

    It is defined in a module, so that it can be pickled.
    """
    if jobs == 1:
        return list(progress(map(function, pieces), len(pieces)))
    with process_pool(jobs, cv2.setNumThreads, threads_each(jobs)) as pool:
        return list(progress(pool.map(function, pieces), len(pieces)))


def threads_each(jobs: int) -> int:
    """Return the number of threads of each of so many processes that share the processors."""
    return max(1, number_of_threads(0) // jobs)
