# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What a launch file adds to the node's environment, and what it is good for."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

from uw_visibility.ros.start import MEMORY, PUBLICATION, node_environment

# Pages that are cleared while large blocks come and go in a thread.
FAULTS = """
import resource, threading
import numpy as np
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


def faults(environment: dict[str, str]) -> int:
    plain = {name: os.environ[name] for name in os.environ.keys() & {"HOME", "PYTHONPATH"}}
    return int(subprocess.check_output([sys.executable, "-c", FAULTS], env=plain | environment))


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the C library is not glibc")
def test_freed_memory_is_not_cleared_anew() -> None:
    # Ten rounds of 20 MB, of which each has 4882 pages of 4 KiB.
    assert faults({}) > 5000
    assert faults(node_environment({})) < 500


def test_what_the_environment_says_holds() -> None:
    assert node_environment({"HOME": "/"}) == MEMORY | PUBLICATION
    for name in (*MEMORY, "GLIBC_TUNABLES"):
        assert node_environment({name: "given"}) == PUBLICATION
    assert node_environment(dict.fromkeys(PUBLICATION, "given")) == MEMORY
