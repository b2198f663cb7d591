# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A recording replayed with a network: which one made the result, and what it lost."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from bag_copies import FRAMES, parameter_file, run
from graphs import save, shifts

from uw_visibility.replay.results.folder import MARK
from uw_visibility.replay.table import read_rows

pytest.importorskip("onnx", reason="onnx is not installed")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

from onnx import helper


def test_the_result_names_its_network(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = shifts(tmp_path / "mine.onnx", 30)
    params = parameter_file(
        tmp_path / "p.yaml", {"stereo.matcher": "onnx", "stereo.model": str(model)})
    out = tmp_path / "out"
    assert run(transect, out, "--params-file", params).code == 0
    state = json.loads((out / MARK).read_text(encoding="utf-8"))
    digest = hashlib.sha256(model.read_bytes()).hexdigest()
    assert state["parameters"]["stereo.model_sha256"] == digest
    assert state["parameters"]["stereo.model"].endswith("mine.onnx")
    assert digest in (out / "report.html").read_text(encoding="utf-8")
    shifts(model, 20)
    again = run(transect, out, "--params-file", params, "--resume", capsys=capsys)
    assert again.code == 2
    assert "was made with another stereo.model_sha256" in again.err


def test_frames_that_the_network_loses_have_the_reason(transect: Path, tmp_path: Path) -> None:
    """All of them: ELAS does not stand in, since frames do not depend on those before."""
    half = [helper.make_node("ReduceMean", ["left"], ["mean"], axes=[1]),
            helper.make_node("Neg", ["mean"], ["less"]),
            helper.make_node("Log", ["less"], ["disparity"])]
    model = save(tmp_path / "nan.onnx", half)
    params = parameter_file(
        tmp_path / "p.yaml", {"stereo.matcher": "onnx", "stereo.model": str(model)})
    out = tmp_path / "out"
    with pytest.raises(SystemExit):
        run(transect, out, "--params-file", params)
    rows = list(read_rows(out / "frames.csv"))
    assert len(rows) == FRAMES
    assert all("nan.onnx gave" in row["reason"] for row in rows)
