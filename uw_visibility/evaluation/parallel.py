# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parallel map over pieces of work, in this process or in several."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

import cv2

Progress = Callable[[Iterator[Any], int], Iterator[Any]]
"""Takes an iterator over what is done and its length, and yields from it."""


def run_all(
    function: Callable[..., Any],
    pieces: Sequence[Any],
    arguments: tuple[Any, ...],
    jobs: int,
    threads: int,
    progress: Progress,
) -> list[Any]:
    """Apply a function to pieces of work.

    Parameters
    ----------
    function : callable
        Takes a piece and the arguments; of a module, so that processes can find it.
    pieces : sequence
        What to work on.
    arguments : tuple
        What each call takes beside its piece.
    jobs : int
        Processes that share the work; the result is the same for any number.
    threads : int
        Threads of OpenCV in each of several processes.
    progress : Progress
        Shows how far it is.

    Returns
    -------
    list
        Results in the order of the pieces.
    """
    results: dict[int, Any] = {}
    with _runner(jobs, threads) as run:
        for index, result in progress(run(function, pieces, arguments), len(pieces)):
            results[index] = result
    return [results[index] for index in range(len(pieces))]


Run = Callable[
    [Callable[..., Any], Sequence[Any], tuple[Any, ...]], Iterator[tuple[int, Any]]
]


@contextmanager
def _runner(jobs: int, threads: int) -> Iterator[Run]:
    """Yield what runs the pieces of work, here or in processes of their own."""
    if jobs == 1:
        def run(
            function: Callable[..., Any], pieces: Sequence[Any], arguments: tuple[Any, ...]
        ) -> Iterator[tuple[int, Any]]:
            return ((i, function(piece, *arguments)) for i, piece in enumerate(pieces))

        yield run
        return
    # Processes are started anew: a fork of one that has threads may never answer.
    pool = ProcessPoolExecutor(
        jobs, mp_context=get_context("spawn"), initializer=cv2.setNumThreads, initargs=(threads,)
    )

    def run_in_pool(
        function: Callable[..., Any], pieces: Sequence[Any], arguments: tuple[Any, ...]
    ) -> Iterator[tuple[int, Any]]:
        futures: dict[Future[Any], int] = {
            pool.submit(function, piece, *arguments): i for i, piece in enumerate(pieces)
        }
        return ((futures[future], future.result()) for future in as_completed(futures))

    try:
        yield run_in_pool
    finally:
        pool.shutdown(cancel_futures=True)
