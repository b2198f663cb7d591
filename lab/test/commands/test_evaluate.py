# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility evaluate`: what it refuses, in one sentence, before any work."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from uw_visibility.cli import main


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "dataset" / "scene"
    folder.mkdir(parents=True)
    for name in ("view1", "view5", "disp1"):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((60, 80, 3), 40, np.uint8))
    return folder


def refuse(capsys, *words: object) -> str:
    """Run the command, expect exit code 2, and return the one sentence."""
    assert main(["evaluate", *map(str, words)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return str(captured.err)


def test_a_missing_folder(tmp_path, capsys):
    assert "nowhere" in refuse(capsys, tmp_path / "nowhere", "-o", tmp_path / "out")


def test_a_folder_without_scenes(tmp_path, capsys):
    (tmp_path / "empty" / "nothing").mkdir(parents=True)
    assert "holds no scene" in refuse(capsys, tmp_path / "empty", "-o", tmp_path / "out")


@pytest.mark.parametrize("name", ["view1.png", "view5.png", "disp1.png"])
def test_an_unreadable_image(scene, tmp_path, capsys, name):
    (scene / name).write_bytes(b"no image")
    words = (scene.parent, "-o", tmp_path / "out", "--quick")
    assert name in refuse(capsys, *words)
    assert not (tmp_path / "out").exists()


def test_two_scenes_of_one_name(scene, capsys, tmp_path):
    assert "two scenes" in refuse(capsys, scene, scene.parent, "-o", tmp_path / "out")


def test_a_folder_in_use(scene, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "cases.csv").write_text("precious")
    # --force replaces earlier results only.
    for words in ([], ["--force"]):
        assert "not left by an evaluation" in refuse(capsys, scene, "-o", out, *words)
    assert (out / "cases.csv").read_text() == "precious"
    (out / "evaluation.json").write_text("{}")
    assert "--force to replace" in refuse(capsys, scene, "-o", out)
    assert "is a file" in refuse(capsys, scene, "-o", out / "cases.csv")


@pytest.mark.parametrize(("words", "named"), [
    (["--jobs", "0"], "--jobs"),
    (["--attenuation", "-0.1"], "attenuations"),
    (["--depth", "2", "nan"], "depths"),
])
def test_options_out_of_range(scene, tmp_path, capsys, words, named):
    assert named in refuse(capsys, scene, "-o", tmp_path / "out", *words)


@pytest.mark.parametrize(("words", "named"), [
    (["--frames", "20"], "--frames is for --lamps"),
    (["--lamps", "--noise", "2"], "--noise is not for --lamps"),
    (["--lamps", "--paper"], "--paper is not for --lamps"),
])
def test_options_of_the_other_study(tmp_path, capsys, words, named):
    assert named in refuse(capsys, "-o", tmp_path / "out", *words)


def test_parameters_that_simulated_water_does_not_have(scene, tmp_path, capsys):
    path = tmp_path / "parameters.yaml"
    path.write_text("/**:\n  ros__parameters:\n    camera.transfer: srgb\n")
    words = (scene, "-o", tmp_path / "out", "--params-file", path)
    assert "camera.transfer" in refuse(capsys, *words)
