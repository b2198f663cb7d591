# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Signals that come while the node starts end it as quietly as later ones."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from uw_visibility.ros import start

pytestmark = pytest.mark.node

ENVIRONMENT = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
COMMAND = "import sys; from uw_visibility.ros.start import {0}; sys.exit({0}())"

# A signal once Python has put back what signals did before it.
LATE = """
import os, signal, sys, types
from uw_visibility.ros import start
class Last:
    kill, process, number = os.kill, os.getpid(), signal.{signal}
    def __del__(self):
        self.kill(self.process, self.number)
module = sys.modules["uw_visibility.ros.node"] = types.ModuleType("node")
module.main = lambda: 3
module.last = Last()
sys.exit(start.node())
"""


def start_python(code: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code], env=ENVIRONMENT, text=True,
        cwd=Path(__file__).resolve().parents[2],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )


@pytest.mark.parametrize(("name", "number"), [
    ("node", signal.SIGINT), ("lifecycle_node", signal.SIGTERM)])
def test_signal_while_modules_are_imported(name: str, number: int) -> None:
    process = start_python(COMMAND.format(name))
    end = time.monotonic() + 60
    while "numpy" not in Path(f"/proc/{process.pid}/maps").read_text():
        assert process.poll() is None and time.monotonic() < end
    process.send_signal(number)
    said = process.communicate(timeout=60)[0]
    # What it is about to do it may tell.
    unexpected = [line for line in said.splitlines() if not line.startswith("[INFO] ")]
    assert (unexpected, process.returncode) == ([], 0)


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_second_signal_does_not_kill_what_ends(number: str) -> None:
    process = start_python(LATE.format(signal=number))
    assert (process.communicate(timeout=60)[0], process.returncode) == ("", 3)


def test_executables_are_those_that_setup_names() -> None:
    setup = (Path(__file__).resolve().parents[2] / "setup.py").read_text(encoding="utf-8")
    for name in (start.node.__name__, start.lifecycle_node.__name__):
        assert f"ros.start:{name}" in setup
