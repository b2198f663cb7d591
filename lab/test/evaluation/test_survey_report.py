# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The survey under lamps through the command: its tables, and what they count."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from uw_visibility.cli import main
from uw_visibility_lab.evaluation import survey
from uw_visibility_lab.evaluation.judging import WIDEST_INTERVAL
from uw_visibility_lab.evaluation.metrics import at_best_exposure
from uw_visibility_lab.simulation.camera import StereoCamera

SMALL = StereoCamera(160, 120, 150.0, 0.12)


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lamps")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(survey, "CAMERA", SMALL)
        assert main(["evaluate", "--lamps", "-o", str(folder), "--frames", "8"]) == 0
    return folder


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_the_summary_counts_the_frames(tables: Path) -> None:
    summary = json.loads((tables / "evaluation.json").read_text())["summary"]
    rows = rows_of(tables / "survey.csv")
    assert len(rows) == summary["frames"] == 8
    for name in ("single", "pooled"):
        distances, stddevs = (
            np.array([float(row[f"{name}.{what}"] or "nan") for row in rows])
            for what in ("distance", "distance_stddev"))
        told = 2.0 * stddevs / distances <= math.log(WIDEST_INTERVAL)
        assert summary[name]["cases"] == 8
        assert summary[name]["told"] == pytest.approx(told.mean())
    assert set(summary["variation"]) == {"raw", "online", "ours", "oracle", "truth"}
    variation = summary["variation"]
    assert all(variation["oracle"][c] < 0.5 * variation["raw"][c] for c in ("red", "blue"))
    assert summary["colour_difference"]["truth"] == 0.0
    difference = summary["colour_difference"]
    # Who knows lamps, water and ranges is not far from the truth.
    assert difference["oracle"] < 0.6 * difference["raw"]
    assert (tables / "survey.png").stat().st_size > 20_000


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
    (["somewhere"], "DATASET"),
])
def test_what_cannot_be_studied_is_refused(
    options: list[str], what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", "--lamps", *options, "-o", str(tmp_path / "out")]) == 2
    assert what in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
