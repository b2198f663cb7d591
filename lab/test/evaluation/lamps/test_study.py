# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The study under lamps through the command: its tables, and what they count."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uw_visibility.cli import main
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility_lab.evaluation.lamps import cases, survey
from uw_visibility_lab.evaluation.lamps.cases import TOLD
from uw_visibility_lab.evaluation.lamps.survey import at_best_exposure
from uw_visibility_lab.evaluation.readings import Reading, Truth
from uw_visibility_lab.evaluation.studies import statistics
from uw_visibility_lab.simulation.camera import StereoCamera

SMALL = StereoCamera(160, 120, 150.0, 0.12)
OPTIONS = ("--quick", "--attenuation", "0.1", "0.3", "--frames", "8")


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lamps")
    with pytest.MonkeyPatch.context() as patch:
        for module in (cases, survey):
            patch.setattr(module, "CAMERA", SMALL)
        assert main(["evaluate", "--lamps", "-o", str(folder), *OPTIONS]) == 0
    return folder


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_every_water_and_rig_is_a_case_with_its_truth(tables: Path) -> None:
    rows = rows_of(tables / "lamp_cases.csv")
    assert [(row["lamps"], row["mean_attenuation"]) for row in rows] == [
        ("2", "0.1"), ("2", "0.3"), ("4", "0.1"), ("4", "0.3")]
    for row in rows:
        beta = min(float(row[f"true.attenuation.{c}"]) for c in ("red", "green", "blue"))
        assert beta == pytest.approx(float(row["mean_attenuation"]) + 0.025, abs=0.002)
        assert float(row["true.distance"]) == pytest.approx(visibility_distance(beta, 0.05))
        assert {row[f"{name}.status"] for name in TOLD} != {""}


def test_the_summary_counts_the_frames(tables: Path) -> None:
    summary = json.loads((tables / "evaluation.json").read_text())["summary"]
    assert summary["frames"] == 4
    for name in TOLD:
        found = summary["told"][name]
        assert 0.0 <= found["right"] <= 1.0 - found["refused"]
        assert sum(summary["lamps"][k][name]["cases"] for k in ("2", "4")) == 4
    assert len(rows_of(tables / "survey.csv")) == summary["survey"]["frames"] == 8
    assert set(summary["survey"]["variation"]) == {
        "raw", "online", "ours", "oracle", "truth"}
    variation = summary["survey"]["variation"]
    assert all(variation["oracle"][c] < 0.5 * variation["raw"][c] for c in ("red", "blue"))
    assert summary["survey"]["colour_difference"]["truth"] == 0.0
    difference = summary["survey"]["colour_difference"]
    # Who knows lamps, water and ranges is not far from the truth.
    assert difference["oracle"] < 0.6 * difference["raw"]
    for name in ("lamps.png", "survey.png"):
        assert (tables / name).stat().st_size > 20_000


def test_right_is_within_a_fifth_and_refused_is_not_right() -> None:
    truth = Truth.of_water([0.5, 0.3, 0.2], [0.0] * 3, [0.2, 0.07, 0.03], 40.0, 0.05)
    base = Reading.refused("too dark")

    def reading(ratio: float) -> Reading:
        return replace(
            base, status="ok", distance_status="ok", distance=ratio * truth.distance,
            distance_stddev=0.01 * truth.distance)

    found = statistics([(truth, r) for r in (reading(1.02), reading(0.85), reading(1.3), base)])
    assert (found["refused"], found["right"]) == (0.25, 0.5)
    assert found["beyond"]["visibility"] == 0.5
    assert found["reasons"] == {"too dark": 1}
    assert statistics([(truth, base)])["right"] == 0.0


def test_an_exposure_is_one_for_all_frames() -> None:
    random = np.random.default_rng(0)
    truth = [random.uniform(0.1, 0.9, (4, 5, 3)).astype(np.float32) for _ in range(3)]
    dim = [np.float32(0.25) * image for image in truth]
    np.testing.assert_allclose(at_best_exposure(dim, truth), truth, rtol=1e-6)
    # A colour cast stays.
    cast = [image * np.array([0.2, 1.0, 1.0], np.float32) for image in truth]
    assert not np.allclose(at_best_exposure(cast, truth), truth, rtol=0.3)


@pytest.mark.parametrize(("options", "what"), [
    (["--frames", "3"], "survey"),
    (["--seeds", "0"], "seeds"),
    (["--attenuation", "-1"], "attenuations"),
    (["somewhere"], "DATASET"),
])
def test_what_cannot_be_studied_is_refused(
    options: list[str], what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", "--lamps", *options, "-o", str(tmp_path / "out")]) == 2
    assert what in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
