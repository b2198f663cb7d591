# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The loop around a node: what ends it, and what does not."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

ENVIRONMENT = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}

NODE = """
import os, signal, sys, threading, time, rclpy
from rclpy.node import Node
from uw_visibility.ros.monitor.faults import FaultLog
from uw_visibility.ros.run import run
class Quiet(Node):
    def __init__(self):
        super().__init__("quiet", start_parameter_services=False)
        self.faults = FaultLog(self)
        self.prepare()
    def prepare(self):
        pass
    def stop(self, timeout):
        return True
"""

# What rclpy's thread for signals does last; it has woken the executor before.
LOST_WAKE = NODE + """
def end():
    time.sleep(1.0)
    handle = rclpy.get_default_context().handle
    with handle:
        handle.shutdown()
threading.Thread(target=end).start()
sys.exit(run(Quiet, []))
"""

FAILING = NODE + """
class Failing(Quiet):
    def prepare(self):
        self.calls = 0
        self.create_timer(0.01, self.fail)
    def fail(self):
        self.calls += 1
        if self.calls == 20:
            finding = self.faults.diagnose()
            print(finding.level == b"\\x02", finding.values["failed callbacks"], flush=True)
            os.kill(os.getpid(), signal.SIGTERM)
        raise OverflowError("cannot convert float infinity to integer")
sys.exit(run(Failing, []))
"""

# A signal comes while the node looks at what it will say of itself.
INTERRUPTED = NODE + """
from uw_visibility.ros.monitor.diagnostics import DiagnosticsPublisher
class Diagnosed(Quiet):
    def prepare(self):
        DiagnosticsPublisher(self, self.diagnose, self.faults)
    def diagnose(self):
        os.kill(os.getpid(), signal.SIGTERM)
        while rclpy.ok():
            time.sleep(0.01)
        return {self.count_publishers("images"): None}
sys.exit(run(Diagnosed, []))
"""


def run_python(code: str) -> tuple[str, str, int]:
    ended = subprocess.run(
        [sys.executable, "-c", code], env=ENVIRONMENT, text=True, timeout=60, check=False,
        capture_output=True, cwd=Path(__file__).resolve().parents[2],
    )
    return ended.stdout, ended.stderr, ended.returncode


def test_node_without_timers_ends_though_the_wake_came_too_early() -> None:
    assert run_python(LOST_WAKE) == ("", "", 0)


def test_callbacks_that_fail_are_counted_and_the_node_lives_until_its_signal() -> None:
    said, logged, code = run_python(FAILING)
    assert (said, code) == ("True 19\n", 0)
    assert logged.count("Traceback") == 1
    assert "a callback failed with OverflowError at " in logged


def test_what_a_signal_lets_fail_is_no_fault() -> None:
    assert run_python(INTERRUPTED) == ("", "", 0)
