# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Memory that a frame's messages have freed serves the next frame's."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import pytest

from uw_visibility.ros.memory import VARIABLES, keep_freed_memory

if platform.libc_ver()[0] != "glibc":
    pytest.skip("the C library is not glibc", allow_module_level=True)

# Pages that are cleared while large blocks come and go in a thread.
FAULTS = """
import resource, sys, threading
import numpy as np
from uw_visibility.ros.memory import keep_freed_memory
if sys.argv[1] == "kept":
    assert keep_freed_memory({})
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


def faults(how: str) -> int:
    done = subprocess.run(
        [sys.executable, "-c", FAULTS, how], capture_output=True, text=True, check=True,
        cwd=Path(__file__).resolve().parents[2], env={"PATH": ""},
    )
    return int(done.stdout)


def test_freed_memory_is_not_cleared_anew() -> None:
    # Ten rounds of 20 MB, of which each has 4882 pages of 4 KiB.
    assert faults("as it is") > 5000
    assert faults("kept") < 500


@pytest.mark.parametrize("name", VARIABLES)
def test_what_the_environment_says_holds(name: str) -> None:
    assert not keep_freed_memory({name: "given"})
