# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reports of the study under lamps: its summary, text for a terminal, CSV and JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uw_visibility.evaluation.lamps.cases import TOLD
from uw_visibility.evaluation.lamps.study import LampPlan
from uw_visibility.evaluation.lamps.survey import PICTURES, SurveyResult
from uw_visibility.evaluation.readings import CHANNELS, Reading, Truth
from uw_visibility.evaluation.studies import StudyResult, by_estimate, line, statistics
from uw_visibility.evaluation.summary import OK, Summary
from uw_visibility.evaluation.tables import told, write_report, write_rows

COLUMNS = (
    ("frames", 7, "cases"), ("assessed", 9, "assessed"), ("refused", 8, "refused"),
    ("right", 7, "right"), ("> 3 σ: β", 10, "beyond.attenuation"),
    ("visib.", 8, "beyond.visibility"), ("depth", 7, "beyond.depth"), ("ratio", 8, "ratio"),
    ("σ", 6, "visibility_relative_stddev"),
)
"""Of the tables of frames: name, width, statistic."""

NEAR = 0.2
"""Relative error of visibility up to which it is right."""


def summarise_lamps(results: Sequence[StudyResult], survey: SurveyResult | None) -> Summary:
    """Reduce a study to its summary.

    Returns
    -------
    dict
        ``told``: over all frames, by the names of `TOLD`; ``lamps``, ``attenuation`` and
        ``surfaces``: the same by these; ``survey``: what it found, or None.
    """
    return {
        "frames": len(results),
        "told": by_estimate(results, of_pairs),
        "lamps": _split(results, "lamps"),
        "attenuation": _split(results, "mean_attenuation"),
        "surfaces": _split(results, "surfaces"),
        "survey": None if survey is None else _of_survey(survey),
    }


def of_pairs(pairs: Sequence[tuple[Truth, Reading]]) -> Summary:
    """Return the adverse study's `statistics`, and how many are assessed and right.

    ``assessed`` and ``right`` (visibility within `NEAR`) are shares of all frames,
    ``right_of_assessed`` of those that are assessed.
    """
    found = statistics(pairs)
    errors = np.array([abs(r.distance / t.distance - 1.0) for t, r in pairs])
    assessed = np.isfinite(errors)
    right = errors <= NEAR
    found["assessed"] = float(assessed.mean())
    found["right"] = float(right.mean())
    found["right_of_assessed"] = float(right[assessed].mean()) if assessed.any() else math.nan
    return found


def _split(results: Sequence[StudyResult], label: str) -> dict[str, dict[str, Summary]]:
    parts: dict[str, list[StudyResult]] = {}
    for result in results:
        value = result.labels[label]
        parts.setdefault(value if isinstance(value, str) else f"{value:g}", []).append(result)
    return {name: by_estimate(some, of_pairs) for name, some in parts.items()}


def _of_survey(survey: SurveyResult) -> Summary:
    truth = survey.rows[-1].truth
    last = survey.rows[-1].pooled
    errors = np.array(last.attenuation) / np.array(truth.attenuation) - 1.0
    first = next(
        (k + 1 for k, row in enumerate(survey.rows) if row.pooled.status == OK), None)
    return {
        "frames": len(survey.rows),
        "cells": survey.cells,
        "views": survey.views,
        "single": of_pairs([(row.truth, row.single) for row in survey.rows]),
        "pooled": of_pairs([(row.truth, row.pooled) for row in survey.rows]),
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
    """Return the summary as tables of up to 100 columns for a terminal."""
    parts = [
        f"{summary['frames']} frames by night; shares of all frames in %; right: visibility "
        "within 20 %;\n> 3 σ: published and farther from the truth; ratio: median of published "
        "over true visibility"
    ]
    for name, title in TOLD.items():
        lines = [line(title, COLUMNS), line("  all", COLUMNS, summary["told"][name])]
        for split, words in (
            ("lamps", "{} lamps"), ("attenuation", "α {} 1/m"), ("surfaces", "{} surfaces"),
        ):
            lines += [
                line(f"  {words.format(value)}", COLUMNS, found[name])
                for value, found in summary[split].items() if len(summary[split]) > 1
            ]
        lines += _reasons(summary["told"][name])
        parts.append("\n".join(lines))
    if summary["survey"] is not None:
        parts.append(_survey_text(summary["survey"]))
    return "\n\n".join(parts)


def write_lamps(
    folder: Path, plan: LampPlan, results: list[StudyResult], survey: SurveyResult | None,
    summary: Summary,
) -> None:
    """Write ``lamp_cases.csv``, ``survey.csv`` and ``evaluation.json``."""
    cases = [result.row() for result in results]
    frames = [] if survey is None else [row.row(k) for k, row in enumerate(survey.rows)]
    write_rows(folder, {"lamp_cases": cases, "survey": frames})
    settings = {
        "attenuations": plan.attenuations,
        "lamps": plan.lamps,
        "surfaces": plan.surfaces,
        "seeds": plan.seeds,
        "ranges": "matched" if plan.matched else "true",
        "survey": None if plan.survey is None else {
            "frames": plan.survey.frames, "lamps": plan.survey.lamps,
            "mean_attenuation": plan.survey.mean_attenuation, "surfaces": plan.survey.surfaces,
        },
        "parameters": told(plan.config),
    }
    report = {"settings": settings, "summary": summary, "cases": cases, "survey": frames}
    write_report(folder, report)


def _reasons(found: Summary) -> list[str]:
    told = "; ".join(f"{reason}: {n}" for reason, n in found["reasons"].items())
    return [f"  refused: {told}"] if told else []


def _survey_text(survey: Summary) -> str:
    lines = [
        f"survey of {survey['frames']} frames; {survey['cells']} pieces of ground, "
        f"each in {survey['views']} frames",
        line("water", COLUMNS),
        line("  each frame alone", COLUMNS, survey["single"]),
        line("  with those before it", COLUMNS, survey["pooled"]),
        *_reasons(survey["pooled"]),
    ]
    errors = ", ".join(
        f"{name} {_signed(survey['attenuation_error'][name])} %" for name in CHANNELS)
    lines.append(f"  error of β at the end: {errors} ({survey['last_status']})")
    lines.append(
        f"{'same ground over frames':26s}{'σ/mean R':>10s}{'G':>8s}{'B':>8s}{'ΔE*ab':>9s}")
    for name, title in PICTURES.items():
        lines.append(
            f"  {title:24s}{_variation(survey['variation'][name])}"
            f"{survey['colour_difference'][name]:9.1f}")
        if name == "online":
            lines.append(
                f"  {'… once light is known':24s}{_variation(survey['settled_variation'])}")
    return "\n".join(lines)


def _variation(shares: dict[str, float]) -> str:
    return "".join(
        f"{100.0 * shares[c]:{width}.1f}" if math.isfinite(shares[c]) else f"{'–':>{width}s}"
        for c, width in zip(CHANNELS, (10, 8, 8), strict=True))


def _signed(share: float) -> str:
    return "–" if not math.isfinite(share) else f"{100 * share:+.0f}"
