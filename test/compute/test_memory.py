# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Freed memory is kept for the next frame."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

# Pages that are cleared while large blocks come and go in a thread.
FAULTS = """
import resource, sys, threading
import numpy as np
from uw_visibility.compute.memory import keep_freed_memory
if sys.argv[1] == "keep":
    keep_freed_memory()
def work():
    for round in range(12):
        if round == 2:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        blocks = [np.ones(5_000_000, np.uint8) for _ in range(4)]
        del blocks
    print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
thread = threading.Thread(target=work)
thread.start()
thread.join()
"""


def faults(how: str, **environment: str) -> int:
    plain = {name: os.environ[name] for name in os.environ.keys() & {"HOME", "PYTHONPATH"}}
    return int(subprocess.check_output(
        [sys.executable, "-c", FAULTS, how], env=plain | environment))


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the C library is not glibc")
def test_freed_memory_is_not_cleared_anew() -> None:
    # Ten rounds of 20 MB, of which each has 4882 pages of 4 KiB.
    assert faults("return") > 5000
    assert faults("keep") < 500
    assert faults("keep", MALLOC_TRIM_THRESHOLD_="131072") > 5000
