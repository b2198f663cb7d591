# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Processes beside this one that import nothing from the current folder.

Python starts them by ``-c`` and ``-m``, which put the current folder first among the places
of modules: a ``multiprocessing.py`` that lies in a downloaded recording would run in each.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from uw_visibility.errors import InputError

# https://docs.python.org/3/using/cmdline.html#envvar-PYTHONSAFEPATH
SAFE_PATH = {"PYTHONSAFEPATH": "1"}


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
    # Processes start as work comes in, so this holds until the end.
    os.environ.update(SAFE_PATH)
    pool = ProcessPoolExecutor(
        jobs, get_context("spawn"), initializer=initializer, initargs=arguments
    )
    try:
        yield pool
    except BrokenProcessPool as error:
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
