# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Thread pool for kernels that release the GIL: they run over bands of rows.

Numba's own parallel loops are not used: their default threading layer ends the
process when two Python threads enter it at once, as a node's worker and a user's
thread may do. Bands are computed independently, so that results do not depend on
the number of threads.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, TypeVar

First = TypeVar("First")
Second = TypeVar("Second")

_BANDS_PER_THREAD = 3


def number_of_threads(threads: int) -> int:
    """Return the number of threads of a parameter: 0 stands for one per processor allowed."""
    if threads:
        return threads
    # Linux limits the processors of a process, as in a container or under taskset.
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def use_one_thread() -> None:
    """Let OpenBLAS use one thread here and in child processes, unless the user has chosen.

    Frames and rows are already shared among processors, and OpenBLAS's threads wait for each other
    actively: on busy processors, the decomposition of a 4000x60 matrix takes 1 s of processor time
    with two threads and 0.01 s with one. OpenBLAS reads the variable when it is loaded: call this
    before NumPy is imported.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


class Workers:
    """A pool of threads (0: one per processor) that runs compiled kernels over bands of rows."""

    def __init__(self, threads: int = 0) -> None:
        self.threads = number_of_threads(threads)
        # The calling thread works too.
        self._pool = ThreadPoolExecutor(self.threads - 1) if self.threads > 1 else None

    def rows(self, kernel: Callable[..., Any], count: int, *arguments: Any) -> None:
        """Run ``kernel(start, stop, *arguments)`` over bands that cover ``count`` rows."""
        if self._pool is None:
            kernel(0, count, *arguments)
            return
        # More bands than threads: rows differ in cost, and a thread that wakes
        # late leaves its bands to the others.
        bands = min(count, _BANDS_PER_THREAD * self.threads)
        edges = [count * i // bands for i in range(bands + 1)]
        # Taking the next number is atomic, so that no two threads get the same one.
        taken = itertools.count()

        def work() -> None:
            for band in taken:
                if band >= bands:
                    return
                kernel(edges[band], edges[band + 1], *arguments)

        helpers = [self._pool.submit(work) for _ in range(self.threads - 1)]
        try:
            work()
        finally:
            # A helper that has not begun has nothing left to do.
            started = [helper for helper in helpers if not helper.cancel()]
            wait(started)
        for helper in started:
            helper.result()

    def together(
        self, first: Callable[[], First], second: Callable[[], Second]
    ) -> tuple[First, Second]:
        """Run two independent calls, in parallel if a thread is free.

        Either may use `rows`, whose caller does the work of threads that are not free. The
        calling thread runs the first. If both raise, the exception of the first is raised.
        """
        if self._pool is None:
            return first(), second()
        helper = self._pool.submit(second)
        try:
            found = first()
        finally:
            # If the second has not begun, it runs here, unless the first has failed.
            begun = not helper.cancel()
            if begun:
                wait([helper])
        return found, helper.result() if begun else second()
