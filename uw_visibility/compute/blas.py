# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Threads of BLAS: one, since frames and rows are already shared among processors.

OpenBLAS's threads wait for each other actively. Where other threads or processes have the
processors, the decomposition of a matrix of 4000x60 takes 1 s of processor time with two
threads and 0.01 s with one.
"""

from __future__ import annotations

import os


def use_one_thread() -> None:
    """Let OpenBLAS use one thread here and in child processes, unless the user has chosen.

    OpenBLAS reads the variable when it is loaded: call this before NumPy is imported.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
