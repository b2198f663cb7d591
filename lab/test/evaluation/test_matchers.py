# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`judge --matcher`: a matcher beside the built-in one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from graphs import shifts

from uw_visibility.cli import main

pytest.importorskip("onnx", reason="onnx is not installed")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

def test_each_water_and_noise_has_both_matchers(
    tmp_path: Path, scene_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = shifts(tmp_path / "shifts.onnx", 63)
    assert main([
        "judge", "--matcher", "onnx", "--model", str(model), "--middlebury",
        str(scene_folder)]) == 0
    head, *lines = capsys.readouterr().out.splitlines()
    assert re.split(r"\s\s+", head)[1:4] == ["matched", "correct", "wrong"]
    found = [re.split(r"\s\s+", line.strip()) for line in lines]
    assert len(found) == 8
    assert [row[0] for row in found[:3]] == [
        "α 0 1/m, no noise, elas", "α 0 1/m, no noise, onnx", "α 0.2 1/m, no noise, elas"]
    for built_in, other in zip(found[::2], found[1::2], strict=True):
        assert built_in[1:5] != other[1:5]
        assert built_in[-1] == "0.00"
    # Half of the scene at least is right, without noise.
    assert all(float(row[2]) > 0.5 for row in found[:4])
