# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What tests of faults share: a small pair and recording."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("rosbags")

# The tests here share what makes bags; pytest's import mode leaves this folder out.
sys.path.insert(0, str(Path(__file__).parent))

from made_once import leave_out_figures
from rosbags.rosbag2 import StoragePlugin
from small_bags import scene, write_ros2

from uw_visibility.images.files import write_png


@pytest.fixture
def plain_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the figures of pages out."""
    leave_out_figures(monkeypatch, "report.report", "day")


@pytest.fixture
def pair(tmp_path: Path) -> list[str]:
    """Options of `enhance` for a small pair."""
    files = [tmp_path / "left.png", tmp_path / "right.png"]
    for file, image in zip(files, scene(1), strict=True):
        write_png(file, image)
    return [*map(str, files), "--focal-length", "90", "--baseline", "0.1", "--max-disparity", "20"]


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of a few tiny frames."""
    return write_ros2(tmp_path_factory.mktemp("faults") / "bag", StoragePlugin.MCAP).parent
