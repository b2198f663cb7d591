# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Processes beside this one that import nothing from the current folder.

Python starts them by ``-c`` and ``-m``, which put the current folder first among the places
of modules: a ``multiprocessing.py`` that lies in a downloaded recording would run in each.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from uw_visibility.errors import InputError

# https://docs.python.org/3/using/cmdline.html#envvar-PYTHONSAFEPATH
SAFE_PATH = {"PYTHONSAFEPATH": "1"}


class _Pool(ProcessPoolExecutor):
    """Pool whose processes take no interruption, from their first moment on.

    Ctrl-C reaches every process of a terminal. One that is still importing would answer with
    a traceback; with the signal blocked it goes on until this process ends it.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        # A private name of Python's, for which there is no public one: all processes start
        # before the thread that watches them, as where they are forked. It iterates over
        # them when one ends, and fails with a traceback where another is added meanwhile.
        self._safe_to_dynamically_spawn_children = False

    def submit(self, *arguments: Any, **named: Any) -> Future[Any]:
        # Processes start with the first work, and inherit the mask.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            return super().submit(*arguments, **named)
        except OSError as error:
            # A process could not be started, as where there is no room for more.
            raise BrokenProcessPool(str(error)) from error
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def end(self) -> None:
        """End the processes, whatever they are at."""
        for process in list((self._processes or {}).values()):
            process.terminate()


@contextmanager
def process_pool(
    jobs: int, initializer: Callable[..., object], *arguments: Any
) -> Iterator[ProcessPoolExecutor]:
    """Start processes anew: a fork of one that has threads may never answer.

    Parameters
    ----------
    jobs : int
        How many.
    initializer : callable
        What each does first, with the arguments.

    Yields
    ------
    ProcessPoolExecutor
        It is shut down at the end, without what has not begun.

    Raises
    ------
    InputError
        If one of them was ended from outside.
    """
    before = {name: os.environ.get(name) for name in SAFE_PATH}
    # Processes start with the first work, so this holds until the end.
    os.environ.update(SAFE_PATH)
    pool = _Pool(
        jobs, get_context("spawn"), initializer=initializer, initargs=arguments
    )
    try:
        yield pool
    except KeyboardInterrupt:
        # Compiling takes a minute, which nobody who interrupts wants to wait for.
        pool.end()
        raise
    except BrokenProcessPool as error:
        # Where one could not be started, nothing watches those that were.
        pool.end()
        raise InputError(
            "a process that works on frames was ended from outside, as where memory is short: "
            "give fewer with --jobs"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
