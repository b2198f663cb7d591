# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Damage of all kinds: read, refused with a sentence, or counted, within time and memory."""

from __future__ import annotations

import functools
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from fuzz import KINDS, WELL, WITH_NODES

SCRIPT = Path(__file__).parent / "fuzz.py"


@functools.cache
def outcomes(*kinds: str) -> tuple[list[dict[str, Any]], int, str]:
    """Return what came of the cases of kinds, run in one process, its exit code and errors."""
    done = subprocess.run(
        [sys.executable, str(SCRIPT), *kinds, "--together"],
        capture_output=True, text=True, timeout=900, check=False,
    )
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    return lines, done.returncode, done.stderr[-2000:]


@pytest.mark.parametrize("kind", [
    pytest.param(kind, marks=pytest.mark.node) if kind in WITH_NODES else kind for kind in KINDS
])
def test_whatever_is_damaged_is_read_or_refused_or_counted(kind: str) -> None:
    if kind in WITH_NODES:
        pytest.importorskip("rclpy", reason="ROS is not installed")
    together = (other for other in KINDS if (other in WITH_NODES) == (kind in WITH_NODES))
    lines, code, said = outcomes(*together)
    lines = [line for line in lines if line["kind"] == kind]
    # Where it ends before its last case, a case has ended it.
    assert len(lines) == KINDS[kind], said
    assert [line for line in lines if line["verdict"] not in WELL] == []
    assert code == 0, said
    # Nor is everything refused.
    assert sum(line["verdict"] == "read" for line in lines) > len(lines) // 30
