# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Processes beside this one that import nothing from the current folder.

Python starts them by ``-c`` and ``-m``, which put the current folder first among the places
of modules: a ``multiprocessing.py`` that lies in a downloaded recording would run in each.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from typing import Any

from uw_visibility.errors import InputError

# https://docs.python.org/3/using/cmdline.html#envvar-PYTHONSAFEPATH
SAFE_PATH = {"PYTHONSAFEPATH": "1"}


class _Pool(ProcessPoolExecutor):
    """Pool whose processes start together, and can be ended."""

    def __init__(self, jobs: int, *arguments: Any, **named: Any) -> None:
        super().__init__(jobs, *arguments, **named)
        self.jobs = jobs
        # A private name of Python's, for which there is no public one: all processes start
        # before the thread that watches them, as where they are forked. It iterates over
        # them when one ends, and fails with a traceback where another is added meanwhile.
        self._safe_to_dynamically_spawn_children = False

    def start(self) -> None:
        """Start the processes.

        Raises `InputError` if the system refuses one.
        """
        try:
            with _interrupted_later():
                self.submit(os.getpid)
        except OSError as error:
            # Nothing watches those that were started before.
            self.end()
            raise InputError(
                f"cannot start {self.jobs} processes, {error}: give fewer with --jobs"
            ) from error

    def end(self) -> None:
        """End the processes, whatever they are at."""
        for process in list((self._processes or {}).values()):
            process.terminate()


@contextmanager
def _interrupted_later() -> Iterator[None]:
    """Put an interruption off to the end, and let processes that are started take none.

    Ctrl-C reaches every process of a terminal. One that is still importing would answer with
    a traceback; with the signal blocked, which is inherited, it goes on until this process
    ends it. Nor must this process leave it without what it is told to do.
    """
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or handler is None:
        # No other thread is interrupted; and a handler that is not Python's is not known.
        yield
        return
    came: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
    if came:
        signal.raise_signal(signal.SIGINT)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Let Python start without the current folder among the places of modules."""
    before = {name: os.environ.get(name) for name in SAFE_PATH}
    os.environ.update(SAFE_PATH)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _begin(initializer: Callable[..., object], *arguments: Any) -> None:
    """Prepare a process of the pool."""
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    initializer(*arguments)


def _end_with_parent() -> None:
    """End this process with the one that started it, however that ends.

    One that is killed tells nobody, and its pool would wait for tasks for ever.
    """
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def process_pool(
    jobs: int, initializer: Callable[..., object], *arguments: Any
) -> Iterator[ProcessPoolExecutor]:
    """Start so many processes anew: a fork of one that has threads may never answer.

    Each calls the initializer first, with the arguments. The pool is shut down at the end, without
    what has not begun. InputError if they cannot be started, or one of them was ended from outside.
    """
    with _safe_path():
        # Of Python's processes one starts here, that keeps account of what they share, and it
        # takes the signal's block back: so the pool's own are started apart from it.
        with _interrupted_later():
            pool = _Pool(
                jobs, get_context("spawn"), initializer=_begin, initargs=(initializer, *arguments)
            )
        try:
            pool.start()
            yield pool
        except KeyboardInterrupt:
            # Compiling takes a minute, which nobody who interrupts wants to wait for.
            pool.end()
            raise
        except BrokenProcessPool as error:
            raise InputError(
                "a process that works on frames was ended from outside, as where memory is "
                "short: give fewer with --jobs"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)
