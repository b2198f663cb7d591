# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility evaluate` on one small scene: what its tables hold against computing it anew."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from uw_visibility import Pipeline, PipelineConfig
from uw_visibility.cli import main
from uw_visibility.errors import InputError
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility_lab.evaluation.baselines import semi_global_matching
from uw_visibility_lab.evaluation.degrade import load_scene
from uw_visibility_lab.evaluation.experiments import Plan
from uw_visibility_lab.evaluation.style import save
from uw_visibility_lab.simulation.camera import Sensor

KAPPA = clear_water_attenuation(load_response("nikon_d5100"))
ALPHA, DEPTH = 0.2, 2.0
OPTIONS = ["--quick"]
TABLES = ("cases.csv", "conditions.csv", "reliability.csv", "evaluation.json")


class Run(NamedTuple):
    folder: Path
    printed: str
    report: dict[str, Any]

    def case(self, alpha: float, noise: str = "0") -> dict[str, Any]:
        (found,) = (
            row for row in self.report["cases"]
            if abs(row["true.mean_attenuation"] - alpha) < 1e-9 and row["noise"] == noise)
        return dict(found)

    def rows(self, name: str) -> list[dict[str, str]]:
        with (self.folder / name).open(encoding="utf-8") as stream:
            return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def run(scene_folder, tmp_path_factory):
    folder = tmp_path_factory.mktemp("evaluation") / "out"
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main(["evaluate", str(scene_folder), "-o", str(folder), *OPTIONS]) == 0
    report = json.loads(
        (folder / "evaluation.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    return Run(folder, printed.getvalue(), report)


@pytest.fixture(scope="module")
def anew(scene_folder):
    """The case of turbid water, computed without the evaluation."""
    scene = load_scene(scene_folder)
    left, right = scene.degraded(ALPHA, DEPTH, KAPPA)
    limit = 16 * (int(np.nanmax(scene.disparity_left)) // 16 + 1)
    # The paper's water, which is lit as the scene is.
    config = PipelineConfig.from_parameters(
        {"water.veil": "paper", "stereo.max_disparity": limit - 1})
    rig = scene.rig
    return scene, left, right, limit, Pipeline(rig, config).process(left, right)


def colour_difference(first, second):
    """Mean ΔE*ab by OpenCV, of code values shown on an sRGB display."""
    first, second = (
        cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
        for image in (first, second))
    return np.linalg.norm(first - second, axis=2).mean()


def correct(disparity, truth):
    known = np.isfinite(truth)
    with np.errstate(invalid="ignore"):
        return (np.abs(disparity - truth) <= 1)[known].mean()


def test_the_truth_stands_in_every_row(run):
    row = run.case(ALPHA)
    beta = KAPPA + ALPHA
    for channel, name in enumerate(("red", "green", "blue")):
        assert row[f"true.attenuation.{name}"] == pytest.approx(beta[channel])
        assert row[f"true.ambient_light.{name}"] == pytest.approx(np.exp(-beta[channel] * DEPTH))
    # Eq. 12 with a contrast of 5 %.
    assert row["true.distance"] == pytest.approx(np.log(10.5) / beta.min())
    assert row["true.depth"] == DEPTH


def test_estimates_are_those_of_the_pipeline(run, anew):
    result = anew[-1]
    row = run.case(ALPHA)
    assert row["pipeline.status"] == "ok"
    for name, field in (
        ("mean_attenuation", "mean_attenuation"), ("depth", "depth"), ("distance", "distance"),
        ("distance_stddev", "distance_stddev"),
    ):
        assert row[f"pipeline.{name}"] == pytest.approx(getattr(result.visibility, field))
    assert row["pipeline.attenuation.green"] == pytest.approx(result.water.attenuation[1])
    assert row["step1.attenuation.green"] == pytest.approx(result.coarse_water.attenuation[1])


def test_exact_ranges_and_the_plain_method_are_other_estimates(run):
    row = run.case(ALPHA)
    names = ("pipeline", "exact", "paper_pipeline", "paper_exact")
    values = [row[f"{name}.mean_attenuation"] for name in names]
    assert len(set(values)) == len(names)
    assert row["exact.mean_attenuation"] == pytest.approx(ALPHA, abs=0.05)


def test_disparities_are_measured_against_the_truth(run, anew):
    scene, left, right, limit, result = anew
    row = run.case(ALPHA)
    sgbm = semi_global_matching(left, right, limit)
    assert row["correct.sgbm"] == pytest.approx(correct(sgbm, scene.disparity_left))
    assert row["matched.sgbm"] == pytest.approx(np.isfinite(sgbm).mean())
    assert row["correct.ours"] == pytest.approx(correct(result.disparity, scene.disparity_left))
    assert row["matched.ours"] == pytest.approx(result.stereo.matched_fraction)
    # Restoring with the true water gives the matcher back what the water took.
    assert row["correct.oracle_sgbm"] > row["correct.sgbm"]


def test_colours_are_measured_against_the_scene_in_air(run, anew):
    scene, left, _, _, result = anew
    row = run.case(ALPHA)
    assert row["colour_difference.degraded"] == pytest.approx(
        colour_difference(left, scene.left), abs=0.05)
    assert row["colour_difference.final"] == pytest.approx(
        colour_difference(result.left_enhanced, scene.left), abs=0.05)
    # Ours may come below the oracle, whose gain nothing limits, on a noisy image.
    others = ("degraded", "histogram", "clahe")
    assert all(
        row["colour_difference.oracle"] < row[f"colour_difference.{name}"] for name in others)
    assert row["colour_difference.step1"] < row["colour_difference.degraded"]


def test_csv_and_json_hold_the_same(run):
    for in_csv, in_json in zip(run.rows("cases.csv"), run.report["cases"], strict=True):
        assert list(in_csv) == list(in_json)
        for text, value in zip(in_csv.values(), in_json.values(), strict=True):
            assert text == ("" if value is None else str(value))


def test_the_summary_is_the_mean_of_the_rows(run):
    cases = [row for row in run.report["cases"] if row["noise"] == "0"]
    assert run.report["summary"]["water"]["exact"]["cases"] == 2
    found = run.report["summary"]["mean_attenuation_error"]["exact"]
    errors = [
        abs(row["exact.mean_attenuation"] - row["true.mean_attenuation"]) for row in cases]
    assert found == pytest.approx(np.mean(errors))
    depths = [
        abs(row["pipeline.depth"] - row["true.depth"]) for row in cases
        if row["pipeline.depth"] is not None]
    assert run.report["summary"]["depth_error"]["pipeline"] == pytest.approx(np.mean(depths))
    means = [row["correct.ours"] for row in cases]
    assert run.report["summary"]["correct"]["ours"] == pytest.approx(np.mean(means))
    assert all(f"{error:.4f}" in run.printed for error in errors)
    assert f"{np.mean(means):.3f}" in run.printed


def test_every_figure_is_drawn(run):
    names = {
        "fig3_reef.png", "fig5.png", "fig6.png", "fig7.png", "fig7_pictures.png", "fig9.png",
        "reliability.png"}
    assert {path.name for path in run.folder.glob("*.png")} == names
    for name in names:
        image = cv2.imread(str(run.folder / name))
        assert min(image.shape[:2]) > 300
        assert image.std() > 10


@pytest.mark.node
def test_two_processes_give_the_same_result(run, scene_folder, tmp_path):
    folder = tmp_path / "out"
    words = ["evaluate", str(scene_folder), "-o", str(folder), *OPTIONS, "--jobs", "2"]
    command = [sys.executable, "-m", "uw_visibility.cli", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    # What takes long tells how far it is.
    assert all(line.startswith("evaluate: ") for line in done.stderr.splitlines()), done.stderr
    for name in TABLES:
        assert (folder / name).read_bytes() == (run.folder / name).read_bytes(), name
    assert done.stdout.replace(str(folder), "") == run.printed.replace(str(run.folder), "")


@pytest.mark.parametrize("file_format, begins", [("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_figures_for_print_are_the_same_each_time(tmp_path, file_format, begins):
    contents = []
    for name in ("one", "two"):
        figure = Figure(figsize=(3.0, 2.0))
        figure.subplots().plot([0.0, 1.0], [1.0, 0.0])
        save(figure, tmp_path / f"{name}.{file_format}")
        contents.append((tmp_path / f"{name}.{file_format}").read_bytes())
    assert contents[0] == contents[1]
    assert contents[0].startswith(begins)


@pytest.mark.parametrize("values", [{"attenuations": ()}, {"depths": (-1.0,)},
                                    {"attenuations": (0.1, float("nan"))}])
def test_a_grid_that_is_no_water_is_refused(values):
    with pytest.raises(InputError, match="give at least 0"):
        Plan([0], **values)


def test_figures_show_the_water_nearest_to_the_papers():
    plan = Plan([0], attenuations=(0.3, 0.0, 0.15), depths=(5.0, 1.0))
    assert plan.attenuations == (0.0, 0.15, 0.3)
    assert plan.shown == (0.15, 1.0)
    assert [case.pictures for case in plan.cases()] == [False, False, True, False, False, False]


def test_noise_is_an_axis_for_ours_and_for_all_peers(run, scene_folder):
    row, quiet = run.case(ALPHA, "2"), run.case(ALPHA)
    scene = load_scene(scene_folder)
    left, right = scene.degraded(ALPHA, DEPTH, KAPPA, Sensor.gaussian(2.0))
    difference = left.astype(float) - scene.degraded(ALPHA, DEPTH, KAPPA)[0]
    assert difference.std() == pytest.approx(2.0, rel=0.05)
    found = semi_global_matching(left, right, 16 * (int(np.nanmax(scene.disparity_left)) // 16 + 1))
    known = np.isfinite(scene.disparity_left)
    error = np.abs(found - scene.disparity_left)
    assert row["correct.sgbm"] == pytest.approx((error[known] <= 1.0).mean())
    assert row["wrong.sgbm"] == pytest.approx((error[known & np.isfinite(found)] > 1.0).mean())
    for name in ("sgbm", "clahe_sgbm", "ours"):
        assert row[f"correct.{name}"] < quiet[f"correct.{name}"]
    table = {(r["noise"], float(r["mean_attenuation"])): r for r in run.rows("conditions.csv")}
    assert set(table) == {(noise, alpha) for noise in ("0", "2") for alpha in (0.0, ALPHA)}
    assert float(table["2", ALPHA]["correct.sgbm"]) == row["correct.sgbm"]
    assert float(table["0", ALPHA]["wrong.ours"]) == quiet["wrong.ours"]


def test_a_noise_that_is_none_is_refused(scene_folder, tmp_path, capsys):
    words = ["evaluate", str(scene_folder), "-o", str(tmp_path / "out"), "--noise"]
    for noise in ("loud", "-1"):
        assert main([*words, noise]) == 2
        error = capsys.readouterr().err
        assert "noise" in error
        assert error.count("\n") == 1
