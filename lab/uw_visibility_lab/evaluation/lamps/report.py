# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Study under lamps: its plan (reefs by night, and a survey), summary and report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

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
    Row,
    as_text,
    flat,
    number,
    write_report,
)

ATTENUATIONS = (0.05, 0.1, 0.2, 0.3)
LAMPS = (2, 4)
"""Numbers of lamps, see `default_rig`."""

SEEDS = 3
FRAMES = 100


def lamp_cases(
    attenuations: Sequence[float], surfaces: Sequence[str], seeds: int
) -> list[LampCase]:
    """Return the cases of a study, reef by reef."""
    check_range("number of seeds", seeds, 1)
    check_range("attenuations", attenuations, 0.0, 5.0, "1/m")
    return [
        LampCase(seed, lamps, attenuation, faced)
        for seed in range(seeds)
        for lamps in LAMPS
        for faced in surfaces
        for attenuation in attenuations
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
    folder: Path, settings: Row, results: Sequence[StudyResult], survey: SurveyResult | None,
    summary: Summary,
) -> None:
    """Write ``lamp_cases.csv``, ``survey.csv`` and ``evaluation.json``."""
    cases = [result.row() for result in results]
    frames = [] if survey is None else [
        flat({"frame": k, "true": survey.truth, "single": single, "pooled": pooled})
        for k, (single, pooled) in enumerate(zip(survey.single, survey.pooled, strict=True))]
    of_survey = None if survey is None else {
        "frames": len(frames), "lamps": surveys.LAMPS,
        "mean_attenuation": surveys.MEAN_ATTENUATION, "surfaces": SURFACES[0],
    }
    write_report(
        folder, {"lamp_cases": cases, "survey": frames},
        {"settings": {"lamps": LAMPS, "survey": of_survey, **settings}, "summary": summary,
         "cases": cases, "survey": frames})


def _survey_text(survey: Summary) -> str:
    errors = ", ".join(
        f"{name} {100 * error:+.0f} %" for name, error in survey["attenuation_error"].items())
    return "\n".join([
        f"survey of {survey['frames']} frames",
        statistics_text("water", [
            ("each frame alone", survey["single"]), ("with those before it", survey["pooled"])]),
        *reasons_text(survey["pooled"]),
        f"  error of β at the end: {errors} ({survey['last_status']})",
        as_text(["same reflectance over frames, σ/median [%]", "R", "G", "B", "ΔE*ab"], [
            [title, *(number(100.0 * survey["variation"][name][c], 1) for c in CHANNELS),
             number(survey["colour_difference"][name], 1)]
            for name, title in PICTURES.items()]),
    ])
