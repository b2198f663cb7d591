# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The adverse study through the command: its tables, their counts, and that they repeat."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import pytest

from uw_visibility.cli import main
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Visibility
from uw_visibility_lab.evaluation.adverse.effects import EFFECTS
from uw_visibility_lab.evaluation.readings import Reading, Truth
from uw_visibility_lab.evaluation.studies import statistics

FEW = ("--effects", "none", "veil", "spectrum", "bright snow", "--attenuation", "0.2")


def study(scene: Path, folder: Path, *options: str) -> Path:
    assert main(["evaluate", "--adverse", str(scene), "-o", str(folder), *FEW, *options]) == 0
    return folder


@pytest.fixture(scope="module")
def tables(scene_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return study(scene_folder, tmp_path_factory.mktemp("adverse"))


def test_every_level_is_a_case_with_its_truth(tables: Path) -> None:
    with (tables / "adverse_cases.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = ("none", "veil", "spectrum", "bright snow")
    expected = [(name, level.label) for name in names for level in EFFECTS[name]]
    assert sorted((row["effect"], row["level"]) for row in rows) == sorted(expected)
    by_level = {row["level"]: row for row in rows}
    model, dim = by_level["the model's water"], by_level["B/W 0.4"]
    assert dim["true.attenuation.red"] == model["true.attenuation.red"]
    ratio = float(dim["true.ambient_light.blue"]) / float(model["true.ambient_light.blue"])
    assert ratio == pytest.approx(0.4)
    # Turbid water of type 5C against the clear one of IB.
    assert (float(by_level["Jerlov 5C"]["true.distance"])
            < 0.5 * float(by_level["Jerlov IB"]["true.distance"]))


def test_the_tables_repeat_and_another_seed_gives_others(
    tables: Path, scene_folder: Path, tmp_path: Path
) -> None:
    again = study(scene_folder, tmp_path / "again")
    for name in ("adverse_cases.csv", "adverse.csv", "evaluation.json"):
        assert (again / name).read_bytes() == (tables / name).read_bytes()
    more = json.loads((study(scene_folder, tmp_path / "more", "--seeds", "2")
                       / "evaluation.json").read_text())
    first, second = (
        [case["ours.attenuation.blue"] for case in more["cases"] if case["seed"] == seed]
        for seed in (0, 1)
    )
    assert first != second


def test_the_summary_counts_each_method(tables: Path) -> None:
    summary = json.loads((tables / "evaluation.json").read_text())["summary"]
    assert summary["adverse"]["ours"]["cases"] == summary["cases"] - 1
    for name in ("none", "veil", "spectrum", "bright snow"):
        for method in ("ours", "paper", "sea_thru"):
            found = summary["effects"][name][method]
            refused = round(found["refused"] * found["cases"])
            assert sum(found["reasons"].values()) >= refused


def test_an_unknown_effect_is_refused_with_the_known_ones(
    scene_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["evaluate", "--adverse", str(scene_folder), "-o", str(tmp_path / "out")]
    assert main([*words, "--effects", "sharks"]) == 2
    error = capsys.readouterr().err
    assert "sharks" in error
    assert "veil" in error
    assert error.count("\n") == 1


def reading(beta: float, beta_stddev: float, distance: float, distance_stddev: float) -> Reading:
    visibility = Visibility(
        Status.OK, Status.OK, 0.1, 0.1, distance, distance_stddev, 3.0, 0.1)
    base = Reading.of(WaterEstimate.not_assessable(Status.OK), visibility)
    return Reading(**{
        **vars(base), "attenuation": (beta,) * 3, "attenuation_stddev": (beta_stddev,) * 3,
    })


def test_statistics_by_hand() -> None:
    truth = Truth(0.1, 3.0, (0.3, 0.3, 0.3), (0.5, 0.5, 0.5), 8.0)
    refused = Reading.refused("too dark")
    found = statistics([
        (truth, reading(0.31, 0.01, 8.0, 1.0)),  # right
        (truth, reading(0.20, 0.02, 12.0, 1.0)),  # β 5 σ, visibility 4 σ and half as long again
        (truth, reading(0.28, 0.01, 10.0, 4.0)),  # within σ, yet a quarter too long
        (truth, refused),
    ])
    assert found["refused"] == 0.25
    assert found["reasons"] == {"too dark": 1}
    assert found["beyond"] == {"attenuation": 0.25, "visibility": 0.25, "depth": 0.0}
    assert found["beyond_any"] == 0.25
    assert found["too_long"] == 0.5
    assert found["ratio"] == pytest.approx(1.25)
    assert found["right"] == 0.25
    assert found["attenuation_error"] == pytest.approx((0.01 + 0.10 + 0.02) / 3)
    assert math.isfinite(found["depth_error"])
