# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Lamps found from a recording of ground at many ranges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uw_visibility.cli import main
from uw_visibility.config.schema import PipelineConfig

SURVEY = [
    "--lamps", "2", "--downward", "--rate", "1", "--speed", "0.1", "--width", "176", "--height",
    "132", "--seed", "5", "--attenuation", "0.15", "0.15", "--threads", "1"]
GUESSED_OFF = np.array([0.15, -0.12, 0.1, -0.15, 0.12, -0.1])


def simulate(bag: Path, *options: str) -> Path:
    assert main(["simulate", "-o", str(bag), *SURVEY, *options]) == 0
    return bag


def test_places_of_lamps_are_found_and_written_as_parameters(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = simulate(tmp_path / "bag", "--frames", "20", "--altitude", "1", "2.5")
    true = PipelineConfig.from_yaml(bag / "lighting.yaml").lighting
    guess, target = tmp_path / "guess.yaml", tmp_path / "lamps.yaml"
    places = (np.array(true.positions) + GUESSED_OFF).tolist()
    guess.write_text(
        "/**: {ros__parameters: {water: {min_range_ratio: 1.5}, lighting: {model: lamps,"
        " directions: [0, 0, 1],"
        f" positions: {places}}}}}}}")
    command = ["calibrate", "--lighting", str(bag), "--params-file", str(guess)]
    command += ["-o", str(target)]
    assert main(command) == 0
    assert "±" in capsys.readouterr().out
    assert (tmp_path / "lamps.png").stat().st_size > 10_000
    config = PipelineConfig.from_yaml(target)
    assert config.water.min_range_ratio == 1.5
    found = config.lighting
    assert found.model == "lamps"
    assert found.position_stddev < 0.12
    off = np.subtract(found.positions, true.positions)
    assert np.abs(off).max() < 3 * found.position_stddev
    assert np.abs(off).mean() < 0.5 * np.abs(GUESSED_OFF).mean()
    turned = [
        np.degrees(np.arccos(np.dot(a.direction, b.direction)))
        for a, b in zip(found.lamps(), true.lamps(), strict=True)]
    assert max(turned) < 3 * found.direction_stddev
    # The file takes the place of a guess, and is not replaced unasked.
    capsys.readouterr()
    assert main(command) == 2
    assert "exists already" in capsys.readouterr().err


def test_ground_at_one_range_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = simulate(tmp_path / "bag", "--frames", "4", "--altitude", "2")
    capsys.readouterr()
    assert main(["calibrate", "--lighting", str(bag), "--lamps", "2"]) == 2
    assert "the ranges differ too little to find lamps" in capsys.readouterr().err
    assert main(["calibrate", "--lighting", str(bag)]) == 2
    assert "give --lamps N" in capsys.readouterr().err
    assert main(["calibrate", str(bag), "--lamps", "2"]) == 2
    assert "--lamps is for --lighting" in capsys.readouterr().err
