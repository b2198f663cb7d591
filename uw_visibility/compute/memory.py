# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Memory of frames: freed memory is kept for the next frame."""

from __future__ import annotations

import ctypes
import os
import sys

# Parameters of mallopt(3), by the environment variables that set them, too. In bytes: free memory
# above the first is returned, and blocks above the second always are; 32 MiB is the largest value
# that all versions of glibc accept.
_PARAMETERS = {
    "MALLOC_TRIM_THRESHOLD_": (-1, 1 << 30),
    "MALLOC_MMAP_THRESHOLD_": (-3, 32 << 20),
}


def keep_freed_memory() -> None:
    """Let glibc keep freed memory in the process, unless the environment says otherwise.

    By default glibc returns large freed blocks to the system, which clears new pages for each
    frame: some 6000 for a megapixel, a twentieth of the frame's time, and more for a point cloud.
    The peak of memory is the same. Other C libraries stay as they are.
    """
    if sys.platform != "linux" or os.environ.keys() & {*_PARAMETERS, "GLIBC_TUNABLES"}:
        return
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        for parameter, value in _PARAMETERS.values():
            libc.mallopt(parameter, value)
