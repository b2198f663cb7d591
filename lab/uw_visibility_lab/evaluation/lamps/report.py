# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Study under lamps: its plan (reefs by night, and a survey), summary and report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import check_range
from uw_visibility_lab.evaluation.lamps import survey as surveys
from uw_visibility_lab.evaluation.lamps.cases import SURFACES, TOLD, LampCase
from uw_visibility_lab.evaluation.lamps.survey import PICTURES, SurveyResult
from uw_visibility_lab.evaluation.studies import (
    LEGEND,
    OK,
    StudyResult,
    Summary,
    by_estimate,
    grouped,
    reasons_text,
    statistics,
    statistics_text,
)
from uw_visibility_lab.evaluation.tables import (
    CHANNELS,
    as_text,
    flat,
    number,
    told,
    write_report,
)

ATTENUATIONS = (0.05, 0.1, 0.2, 0.3)
LAMPS = (2, 4)
"""Numbers of lamps, see `default_rig`."""

SEEDS = 3
FRAMES = 100


@dataclass(frozen=True)
class LampPlan:
    """Plan of a study under lamps."""

    attenuations: tuple[float, ...] = ATTENUATIONS  # attenuation by grey particles, 1/m
    surfaces: tuple[str, ...] = SURFACES  # of `SURFACES`
    seeds: int = SEEDS  # number of reefs, each with a pose and noise of its own
    survey: int = FRAMES  # number of frames of the survey; 0 for none
    # what the pipeline is told beside the lamps
    config: PipelineConfig = field(default_factory=PipelineConfig)

    def __post_init__(self) -> None:
        check_range("number of seeds", self.seeds, 1)
        check_range("attenuations", self.attenuations, 0.0, 5.0, "1/m")
        if self.survey:
            check_range(
                "number of frames of the survey", self.survey, surveys.FEWEST_FRAMES, 10_000)

    def cases(self) -> list[LampCase]:
        """Return the cases, reef by reef."""
        return [
            LampCase(seed, lamps, attenuation, surfaces)
            for seed in range(self.seeds)
            for lamps in LAMPS
            for surfaces in self.surfaces
            for attenuation in self.attenuations
        ]


def summarise_lamps(results: Sequence[StudyResult], survey: SurveyResult | None) -> Summary:
    """Reduce a study to its summary.

    Returns: ``told``: over all frames, by the names of `TOLD`; ``lamps``, ``attenuation`` and
        ``surfaces``: the same by these; ``survey``: what it found, or None.
    """
    return {
        "frames": len(results),
        "told": by_estimate(results),
        "lamps": _split(results, "lamps"),
        "attenuation": _split(results, "mean_attenuation"),
        "surfaces": _split(results, "surfaces"),
        "survey": None if survey is None else _of_survey(survey),
    }


def _split(results: Sequence[StudyResult], label: str) -> dict[str, dict[str, Summary]]:
    parts = grouped(results, lambda result: result.labels[label])
    return {
        value if isinstance(value, str) else f"{value:g}": by_estimate(some)
        for value, some in parts.items()}


def _of_survey(survey: SurveyResult) -> Summary:
    truth, last = survey.truth, survey.pooled[-1]
    errors = np.array(last.attenuation) / np.array(truth.attenuation) - 1.0
    first = next((k + 1 for k, each in enumerate(survey.pooled) if each.status == OK), None)
    return {
        "frames": len(survey.pooled),
        "cells": survey.cells,
        "views": survey.views,
        "single": statistics([(truth, reading) for reading in survey.single]),
        "pooled": statistics([(truth, reading) for reading in survey.pooled]),
        "first_assessed": first,
        "last_status": last.status,
        "attenuation": dict(zip(CHANNELS, truth.attenuation, strict=True)),
        "attenuation_error": dict(zip(CHANNELS, errors.tolist(), strict=True)),
        "variation": {
            name: dict(zip(CHANNELS, survey.variation[name].tolist(), strict=True))
            for name in PICTURES
        },
        "settled_variation": dict(zip(CHANNELS, survey.settled.tolist(), strict=True)),
        "colour_difference": {name: survey.difference[name] for name in PICTURES},
    }


def lamps_text(summary: Summary) -> str:
    """Return the summary as tables for a terminal."""
    parts = [f"{summary['frames']} frames by night\n{LEGEND}"]
    for name, title in TOLD.items():
        groups = [("all", summary["told"][name])]
        for split, words in (
            ("lamps", "{} lamps"), ("attenuation", "α {} 1/m"), ("surfaces", "{} surfaces"),
        ):
            groups += [
                (words.format(value), found[name])
                for value, found in summary[split].items() if len(summary[split]) > 1]
        lines = [statistics_text(title, groups), *reasons_text(summary["told"][name])]
        parts.append("\n".join(lines))
    if summary["survey"] is not None:
        parts.append(_survey_text(summary["survey"]))
    return "\n\n".join(parts)


def write_lamps(
    folder: Path, plan: LampPlan, results: Sequence[StudyResult], survey: SurveyResult | None,
    summary: Summary,
) -> None:
    """Write ``lamp_cases.csv``, ``survey.csv`` and ``evaluation.json``."""
    cases = [result.row() for result in results]
    frames = [] if survey is None else [
        flat({"frame": k, "true": survey.truth, "single": single, "pooled": pooled})
        for k, (single, pooled) in enumerate(zip(survey.single, survey.pooled, strict=True))]
    settings = {
        "attenuations": plan.attenuations,
        "lamps": LAMPS,
        "surfaces": plan.surfaces,
        "seeds": plan.seeds,
        "survey": None if survey is None else {
            "frames": plan.survey, "lamps": surveys.LAMPS,
            "mean_attenuation": surveys.MEAN_ATTENUATION, "surfaces": SURFACES[0],
        },
        "parameters": told(plan.config),
    }
    write_report(
        folder, {"lamp_cases": cases, "survey": frames},
        {"settings": settings, "summary": summary, "cases": cases, "survey": frames})


def _survey_text(survey: Summary) -> str:
    variations = {title: survey["variation"][name] for name, title in PICTURES.items()}
    differences = {
        title: survey["colour_difference"][name] for name, title in PICTURES.items()}
    variations[f"{PICTURES['online']}, light known"] = survey["settled_variation"]
    errors = ", ".join(
        f"{name} {100 * error:+.0f} %" for name, error in survey["attenuation_error"].items())
    return "\n".join([
        f"survey of {survey['frames']} frames; {survey['cells']} pieces of ground, "
        f"each in {survey['views']} frames",
        statistics_text("water", [
            ("each frame alone", survey["single"]), ("with those before it", survey["pooled"])]),
        *reasons_text(survey["pooled"]),
        f"  error of β at the end: {errors} ({survey['last_status']})",
        as_text(["same ground over frames, σ/mean [%]", "R", "G", "B", "ΔE*ab"], [
            [title, *(number(100.0 * shares[c], 1) for c in CHANNELS),
             number(differences[title], 1) if title in differences else ""]
            for title, shares in variations.items()]),
    ])
