# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Gives memory that is no longer used back to the system."""

from __future__ import annotations

import ctypes
import gc


def release_memory() -> None:
    """Return unused memory to the system, as after a clean-up.

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
