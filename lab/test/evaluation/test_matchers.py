# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`evaluate` of a matcher that parameters name."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from graphs import shifts

from uw_visibility.cli import main

pytest.importorskip("onnx", reason="onnx is not installed")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")


def evaluate(folder: Path, scene: Path, **stereo: str) -> int:
    lines = [f"    stereo.{name}: {value}" for name, value in stereo.items()]
    path = folder / "parameters.yaml"
    path.write_text("\n".join(["/**:", "  ros__parameters:", *lines]))
    return main([
        "evaluate", str(scene), "--attenuation", "0.2", "--depth", "2", "--noise", "0",
        "--params-file", str(path), "-o", str(folder / "out")])


def test_a_network_takes_the_place_of_the_matcher(tmp_path: Path, scene_folder: Path) -> None:
    model = shifts(tmp_path / "shifts.onnx", 63)
    assert evaluate(tmp_path, scene_folder, matcher="onnx", model=str(model)) == 0
    report = json.loads((tmp_path / "out" / "evaluation.json").read_text(encoding="utf-8"))
    assert report["settings"]["parameters"]["stereo.matcher"] == "onnx"
    with (tmp_path / "out" / "conditions.csv").open(encoding="utf-8") as stream:
        (row,) = csv.DictReader(stream)
    # The graph has no prior: less is right than by the built-in matcher, but most is.
    assert 0.5 < float(row["correct.ours"]) < 0.9


@pytest.mark.parametrize(("matcher", "sentence"), [
    ("raft", "give one of elas, onnx"), ("onnx", "stereo.model is empty"),
])
def test_a_matcher_that_is_none_is_one_sentence(
    matcher: str, sentence: str, tmp_path: Path, scene_folder: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert evaluate(tmp_path, scene_folder, matcher=matcher) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert sentence in line
