# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The endurance run finds growth, and a short one of it passes."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")


@pytest.fixture(scope="module")
def soak() -> Any:
    path = Path(__file__).with_name("soak.py")
    specification = importlib.util.spec_from_file_location("soak", path)
    assert specification is not None and specification.loader is not None
    module = sys.modules["soak"] = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def numbers(frames: int = 10, failed: int = 0, callbacks: int = 0) -> dict[str, dict[str, str]]:
    return {
        "input": {"stereo frames": str(frames)},
        "pipeline": {
            "frames processed": "6", "frames refused": "3", "frames skipped": "1",
            "frames failed": str(failed),
        },
        "callbacks": {"failed callbacks": str(callbacks)},
    }


@pytest.mark.parametrize(("rate", "found"), [(0.0, []), (0.2, ["memory grew by "])])
def test_growth_after_the_start_is_a_fault(soak: Any, rate: float, found: list[str]) -> None:
    # The start may take what it needs.
    samples = [
        soak.Sample(float(t), 200.0 + min(t, 100) + rate * t, 30, 20) for t in range(300)
    ]
    grown = soak.growth(samples, 120.0)
    faults = soak.faults(numbers(), "", 0, grown, samples)
    assert [fault[: len(text)] for fault, text in zip(faults, found, strict=True)] == found


@pytest.mark.parametrize(("given", "log", "code", "text"), [
    (numbers(frames=11), "", 0, "11 frames went in"),
    (numbers(frames=12, failed=2), "", 0, "2 frames were lost"),
    (numbers(callbacks=1), "", 0, "callbacks failed"),
    (numbers(), "Traceback (most recent call last)", 0, "a traceback"),
    (numbers(), "", -11, "the node ended with -11"),
])
def test_what_must_not_be_is_a_fault(
    soak: Any, given: dict[str, dict[str, str]], log: str, code: int, text: str
) -> None:
    samples = [soak.Sample(0.0, 200.0, 30, 20)]
    (fault,) = soak.faults(given, log, code, soak.growth(samples, 0.0), samples)
    assert text in fault


@pytest.mark.node
@pytest.mark.parametrize("seed", [3])
def test_short_run_is_survived_and_accounted_for(soak: Any, seed: int) -> None:
    result = soak.run(0.3, seed)
    assert result["good pairs"] > 20 and result["bad pairs"] > 60
    assert result["frames with a distance"] > 0
    assert result["course"][-1]["until (min)"] >= 0.2
    assert all(row["memory"] > 50 and row["threads"] > 1 for row in result["course"])
    # All of it is start.
    assert [fault for fault in result["faults"] if " grew by " not in fault] == []
