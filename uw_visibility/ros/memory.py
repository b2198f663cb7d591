# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Allocator settings: the memory of a frame's messages is kept for the next frame.

The C library gives large blocks back to the system when they are freed, so that each frame
has its pages cleared anew: for a cloud of points that takes longer than filling it.
"""

from __future__ import annotations

import ctypes
import gc
import os
from collections.abc import Mapping

# mallopt(3): M_TRIM_THRESHOLD and M_MMAP_THRESHOLD.
TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
# Free memory beyond this goes back to the system, bytes: all messages of a large frame.
KEPT = 128 << 20
# Larger blocks are the system's own in any case, bytes: the most that mallopt takes.
LARGEST = 32 << 20
# With any of these somebody has set up the C library already.
VARIABLES = ("GLIBC_TUNABLES", "MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_")


def keep_freed_memory(environment: Mapping[str, str] = os.environ) -> bool:
    """Let the C library keep freed memory, to be called before threads are started.

    Parameters
    ----------
    environment : mapping of str to str
        Of the process.

    Returns
    -------
    bool
        Whether it does; not where the environment sets it up otherwise, or the C library
        is another one than glibc.
    """
    if any(environment.get(name) for name in VARIABLES):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except AttributeError:
        return False
    return bool(mallopt(MMAP_THRESHOLD, LARGEST)) and bool(mallopt(TRIM_THRESHOLD, KEPT))


def release_memory() -> None:
    """Give what is not in use back to the system, as after a clean-up.

    Each thread frees into an arena of its own, so that without this every new worker would
    leave one frame's memory behind.
    """
    # What the work consists of refers to one another, so that counting alone frees nothing.
    gc.collect()
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except AttributeError:
        # Another C library than glibc.
        return
    trim(0)
