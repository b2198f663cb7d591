# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pools of processes that import nothing from the current folder.

Python starts processes by ``-c`` and ``-m``, which put the current folder first in the search path
of modules: a ``multiprocessing.py`` in a downloaded recording would run in each of them.
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

from uw_visibility.compute.memory import keep_freed_memory
from uw_visibility.errors import InputError

# https://docs.python.org/3/using/cmdline.html#envvar-PYTHONSAFEPATH
SAFE_PATH = {"PYTHONSAFEPATH": "1"}


class _Pool(ProcessPoolExecutor):
    """Process pool that starts all processes at once, and can terminate them."""

    def __init__(self, jobs: int, *arguments: Any, **named: Any) -> None:
        super().__init__(jobs, *arguments, **named)
        self.jobs = jobs
        # Private, since Python has no public name for it: all processes start before the
        # thread that watches them, as with fork. When a process ends, this thread iterates
        # over all of them, and fails with a traceback if another one is added meanwhile.
        self._safe_to_dynamically_spawn_children = False

    def start(self) -> None:
        """Start all processes.

        Raises `InputError` if the system refuses one.
        """
        try:
            with _interrupted_later():
                self.submit(os.getpid)
        except OSError as error:
            # No thread watches the processes that have started.
            self.end()
            raise InputError(
                f"cannot start {self.jobs} processes, {error}: give fewer with --jobs"
            ) from error

    def end(self) -> None:
        """Terminate all processes, also busy ones."""
        for process in list((self._processes or {}).values()):
            process.terminate()


@contextmanager
def _interrupted_later() -> Iterator[None]:
    """Delay Ctrl-C in this process until the end, and block it in processes that start.

    Ctrl-C reaches every process of a terminal. One that is still importing would print a
    traceback; with the signal blocked, which it inherits, it runs until this process ends it.
    This process must not be interrupted before it has told a new one what to do.
    """
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or handler is None:
        # Only the main thread is interrupted; a handler that is not Python's is unknown.
        yield
        return
    received: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: received.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
    if received:
        signal.raise_signal(signal.SIGINT)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Start Python processes without the current folder in the search path of modules."""
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
    """Initialise a process of the pool."""
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    keep_freed_memory()
    initializer(*arguments)


def _end_with_parent() -> None:
    """End this process when its parent has ended.

    A parent that is killed cannot end its pool, which would wait for tasks for ever.
    """
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def process_pool(
    jobs: int, initializer: Callable[..., object], *arguments: Any
) -> Iterator[ProcessPoolExecutor]:
    """Start a pool of `jobs` processes by spawn, since forking with threads may deadlock.

    Each process first calls the initializer with the arguments. At the end the pool is shut down,
    without pending tasks. Raises `InputError` if processes cannot start or are ended from outside.
    """
    with _safe_path():
        # Python's resource tracker starts here and unblocks the signal, so the processes of the
        # pool are started separately.
        with _interrupted_later():
            pool = _Pool(
                jobs, get_context("spawn"), initializer=_begin, initargs=(initializer, *arguments)
            )
        try:
            pool.start()
            yield pool
        except KeyboardInterrupt:
            # Do not wait for a compilation, which may take a minute.
            pool.end()
            raise
        except BrokenProcessPool as error:
            raise InputError(
                "a process that works on frames was ended from outside, perhaps because memory is "
                "short: give fewer with --jobs"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)
