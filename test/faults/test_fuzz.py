# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Damage of all kinds: read, refused with a sentence, or counted, within time and memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz import KINDS, WELL, WITH_NODES

SCRIPT = Path(__file__).parent / "fuzz.py"


@pytest.mark.parametrize("kind", [
    pytest.param(kind, marks=pytest.mark.node) if kind in WITH_NODES else kind for kind in KINDS
])
def test_whatever_is_damaged_is_read_or_refused_or_counted(kind: str) -> None:
    if kind in WITH_NODES:
        pytest.importorskip("rclpy", reason="ROS is not installed")
    done = subprocess.run(
        [sys.executable, str(SCRIPT), kind], capture_output=True, text=True, timeout=900
    )
    outcomes = [json.loads(line) for line in done.stdout.splitlines()]
    # Where it ends before its last case, a case has ended it.
    assert len(outcomes) == KINDS[kind], done.stderr[-2000:]
    assert [line for line in outcomes if line["verdict"] not in WELL] == []
    assert done.returncode == 0
    # Nor is everything refused.
    assert sum(line["verdict"] == "read" for line in outcomes) > len(outcomes) // 30
