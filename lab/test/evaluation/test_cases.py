# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A pair that the pipeline refuses is a result: counted, drawn, and in no mean of ours."""

from __future__ import annotations

import csv
import json
import math

import cv2
import numpy as np
import pytest

from uw_visibility import PipelineConfig
from uw_visibility_lab.evaluation.cases import READINGS, Case, evaluate_case
from uw_visibility_lab.evaluation.experiments import Evaluation, Plan
from uw_visibility_lab.evaluation.figures import write_figures
from uw_visibility_lab.evaluation.report import summarise, summary_text, write_evaluation


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    """An evaluation of one scene that shows one colour only."""
    folder = tmp_path_factory.mktemp("scenes") / "wall"
    folder.mkdir()
    for name in ("view1", "view5"):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((120, 160, 3), (50, 90, 130), np.uint8))
    cv2.imwrite(str(folder / "disp1.png"), np.full((120, 160), 90, np.uint8))
    case = evaluate_case(
        Case(folder, 0.2, 2.0, pictures=True, thumbnails=True), PipelineConfig())
    plan = Plan([folder], attenuations=(0.2,), depths=(2.0,))
    return Evaluation(plan, [case])


def test_it_says_why_and_has_no_estimate(refused):
    (case,) = refused.cases
    assert "nothing can be matched" in str(case.refusal)
    for name in ("step1", "pipeline", "paper_pipeline"):
        assert case.readings[name].status == case.refusal
        assert math.isnan(case.readings[name].mean_attenuation)
    # With exact ranges there is an estimate to refuse, of a wall without spread of range.
    assert case.readings["exact"].status not in ("ok", case.refusal)
    assert list(case.readings) == list(READINGS)


def test_its_disparities_are_none_and_its_colours_unknown(refused):
    (case,) = refused.cases
    assert (case.matched["ours"], case.correct["ours_raw"]) == (0.0, 0.0)
    assert math.isnan(case.colour_difference["final"])
    assert math.isfinite(case.colour_difference["oracle"])


def test_the_summary_counts_it(refused):
    summary = summarise(refused)
    water = summary["water"]["pipeline"]
    assert (water.cases, water.told) == (1, 0.0)
    assert math.isnan(summary["mean_attenuation_error"]["pipeline"])
    assert math.isnan(summary["colour_difference"]["final"])
    text = summary_text(refused, summary)
    assert f"{READINGS['pipeline']}: pair refused" in text


def test_its_row_is_empty_where_nothing_was_assessed(refused, tmp_path):
    write_evaluation(tmp_path, refused, summarise(refused))
    report = json.loads(
        (tmp_path / "evaluation.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    with (tmp_path / "cases.csv").open(encoding="utf-8") as stream:
        (row,) = csv.DictReader(stream)
    for column in ("pipeline.mean_attenuation", "colour_difference.final", "step1.depth"):
        assert report["cases"][0][column] is None
        assert row[column] == ""
    assert row["pipeline.status"] == row["refusal"] == refused.cases[0].refusal


@pytest.mark.long
def test_its_figures_are_drawn_nevertheless(refused, tmp_path):
    write_figures(tmp_path, refused)
    assert {path.name for path in tmp_path.iterdir()} == {
        "fig3_wall.png", "fig5.png", "fig6.png", "fig7.png", "fig7_pictures.png", "fig9.png",
        "reliability.png"}
