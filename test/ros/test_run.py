# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The loop around a node: what ends it, and what does not."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from uw_visibility.ros.run import (
    PROFILES,
    PROFILES_VARIABLE,
    give_memory,
    scarce_memory,
)

pytest.importorskip("rclpy", reason="ROS is not installed")

ENVIRONMENT = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}

NODE = """
import os, signal, sys, threading, time, rclpy
from rclpy.node import Node
from uw_visibility.ros.monitor import FaultLog
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

# A signal while the executor sleeps, which no callback of the node's wakes.
ASLEEP = NODE + """
threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGTERM)).start()
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

# What rclpy's own handlers do to a context, they have done after so long.
INTERRUPT = """
def interrupt():
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.3)
"""

# A signal comes while the node looks at what it will say of itself.
IN_A_CALLBACK = NODE + INTERRUPT + """
from uw_visibility.ros.monitor import publish_diagnostics
class Diagnosed(Quiet):
    def prepare(self):
        publish_diagnostics(self, self.diagnose, self.faults)
    def diagnose(self):
        interrupt()
        print(rclpy.ok(), self.count_publishers("/diagnostics"))
        return {}
sys.exit(run(Diagnosed, []))
"""

# A signal comes once the node is made, before anything is called back.
BEFORE_CALLBACKS = NODE + INTERRUPT + """
class Made(Quiet):
    def create_timer(self, *arguments, **options):
        interrupt()
        return super().create_timer(*arguments, **options)
sys.exit(run(Made, []))
"""

# Signals come while the worker computes, of whose threads Python's exit would wait.
IN_THE_WORKER = NODE + INTERRUPT + """
from concurrent.futures import ThreadPoolExecutor
from uw_visibility.ros.worker import NewestWorker
class Computing(Quiet):
    def prepare(self):
        self.worker = NewestWorker(print, self.compute)
        self.worker.start()
        interrupt()
        self.create_publisher(self.kind(), "late", 1)
    def kind(self):
        from std_msgs.msg import Float64
        return Float64
    def compute(self):
        ThreadPoolExecutor(1).submit(time.sleep, 60.0).result()
    def stop(self, timeout):
        interrupt()
        return self.worker.stop(timeout)
sys.exit(run(Computing, []))
"""


def run_python(code: str) -> tuple[str, str, int]:
    ended = subprocess.run(
        [sys.executable, "-c", code], env=ENVIRONMENT, text=True, timeout=40, check=False,
        capture_output=True, cwd=Path(__file__).resolve().parents[2],
    )
    return ended.stdout, ended.stderr, ended.returncode


@pytest.mark.parametrize(("arguments", "message"), [
    (
        ["--ros-args", "-p", "use_sim_time:=hello"],
        "'use_sim_time' to 'hello' of type 'STRING', expecting type 'BOOL'",
    ),
    (["--params-file", "my.yaml"], "--params-file: ROS arguments follow --ros-args"),
    (["--ros-args", "-p", "use_sim_time:=true", "--", "rectify:=1"], "unknown argument rectify:=1"),
])
def test_what_rclpy_does_not_understand_is_one_sentence_and_exit_code_2(
    arguments: list[str], message: str
) -> None:
    said, logged, code = run_python(NODE + f"sys.exit(run(Quiet, {arguments}))")
    assert (said, code) == ("", 2)
    (line,) = logged.splitlines()
    assert line.startswith("uw_visibility: ") and message in line


def test_signal_ends_a_node_without_timers() -> None:
    assert run_python(ASLEEP) == ("", "", 0)


def test_callbacks_that_fail_are_counted_and_the_node_lives_until_its_signal() -> None:
    said, logged, code = run_python(FAILING)
    assert (said, code) == ("True 19\n", 0)
    assert logged.count("Traceback") == 1
    assert "a callback failed with OverflowError at " in logged


def test_signal_takes_nothing_away_from_a_callback() -> None:
    assert run_python(IN_A_CALLBACK) == ("True 1\n", "", 0)


def test_signal_before_the_first_callback() -> None:
    assert run_python(BEFORE_CALLBACKS) == ("", "", 0)


def test_signals_while_the_node_is_made_and_ended_and_its_worker_computes() -> None:
    # Well before the worker has done.
    assert run_python(IN_THE_WORKER) == ("", "", 0)


def test_memory_is_given_for_a_whole_frame(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    environment: dict[str, str] = {}
    assert give_memory(environment)
    assert environment == {PROFILES_VARIABLE: str(PROFILES)}
    size = re.search(r"<segment_size>(\d+)</segment_size>", PROFILES.read_text(encoding="utf-8"))
    # Two enhanced images and the disparity.
    assert size is not None and int(size[1]) > 640 * 480 * (3 + 3 + 4)


@pytest.mark.parametrize("name", [
    PROFILES_VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS",
    "SKIP_DEFAULT_XML_FILE",
])
def test_what_the_environment_says_holds(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    environment = {name: "given"}
    assert not give_memory(environment)
    assert environment == {name: "given"}


def test_what_the_current_folder_says_holds(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").touch()
    environment: dict[str, Any] = {}
    assert not give_memory(environment)
    assert environment == {}


def test_too_little_memory_for_sockets_is_said_with_its_remedy(tmp_path: Path) -> None:
    allowed = tmp_path / "rmem_max"
    assert scarce_memory(allowed) == ""
    allowed.write_text("212992\n")
    assert "208 KiB" in scarce_memory(allowed)
    assert "sysctl -w net.core.rmem_max=" in scarce_memory(allowed)
    allowed.write_text("4194304\n")
    assert scarce_memory(allowed) == ""
