# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Threads of BLAS: one in the command and in the nodes, unless the user has chosen."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

STARTS = {
    "command": """
import os, uw_visibility.cli as cli
cli.main = lambda: print(os.environ["OPENBLAS_NUM_THREADS"]) or 0
cli.run()
""",
    "node": """
import os, sys, types
from uw_visibility.ros import start
sys.modules["stand_in"] = types.SimpleNamespace(
    main=lambda: print(os.environ["OPENBLAS_NUM_THREADS"]) or 0)
start._start("stand_in")
""",
}


@pytest.mark.parametrize(("chosen", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
@pytest.mark.parametrize("start", STARTS)
def test_blas_has_one_thread_unless_the_user_has_chosen(
    start: str, chosen: dict[str, str], threads: str
) -> None:
    plain = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    said = subprocess.check_output(
        [sys.executable, "-c", STARTS[start]], text=True, env=plain | chosen)
    assert said.strip() == threads
