# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The command of the worlds."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from uw_visibility_lab.worlds.__main__ import COLUMNS, main


def test_a_pool_is_made_and_looked_at(tmp_path: Path) -> None:
    folder, sheet = tmp_path / "pool", tmp_path / "sheet.png"
    assert main(["pool", "--count", "2", "--seed", "1", "-o", str(folder), "--size", "60", "80"]
                ) == 0
    assert len(list(folder.iterdir())) == 2
    assert main(["sheet", str(folder), "-o", str(sheet), "--count", "4"]) == 0
    assert cv2.imread(str(sheet)).shape == (60, 80 * COLUMNS, 3)


def test_bad_input_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pool", "--count", "0", "-o", str(tmp_path)]) == 2
    assert "--count is 0" in capsys.readouterr().err
    assert main(["pool", "--count", "1", "-o", str(tmp_path / "pool"), "--jobs", "0"]) == 2
    assert "--jobs is 0" in capsys.readouterr().err
    assert main(["sheet", str(tmp_path), "-o", str(tmp_path / "x.png")]) == 2
    assert "holds no scene" in capsys.readouterr().err
