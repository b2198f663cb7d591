# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Threads for kernels that release the GIL: bands of rows, in a pool that lives on.

Numba's own parallel loops are not used: their default threading layer ends the
process when two Python threads enter it at once, which a node's worker and a
user's thread may well do. A band of rows is computed alone, so results do not
depend on how many threads there are.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any


class Workers:
    """A pool of threads that runs compiled kernels over bands of rows.

    Parameters
    ----------
    threads : int
        Number of threads; 0 takes one per processor.
    """

    def __init__(self, threads: int = 0) -> None:
        self.threads = threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self.threads) if self.threads > 1 else None

    def rows(self, kernel: Callable[..., Any], count: int, *arguments: Any) -> None:
        """Run ``kernel(start, stop, *arguments)`` over bands that cover ``count`` rows."""
        if self._pool is None:
            kernel(0, count, *arguments)
            return
        # Twice as many bands as threads: rows differ in cost, and a band that
        # ends early leaves its thread to the next.
        bands = min(count, 2 * self.threads)
        edges = [count * i // bands for i in range(bands + 1)]
        futures = [
            self._pool.submit(kernel, edges[i], edges[i + 1], *arguments) for i in range(bands)
        ]
        for future in futures:
            future.result()

    def together(self, *calls: Callable[[], Any]) -> list[Any]:
        """Run calls side by side (never from within another call) and return their results."""
        if self._pool is None:
            return [call() for call in calls]
        futures = [self._pool.submit(call) for call in calls]
        return [future.result() for future in futures]
