# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reports of the experiments and of a survey: tables, `evaluation.json`, and text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.config.schema import PipelineConfig
from uw_visibility_lab.evaluation.cases import IMAGES, MATCHES, READINGS, CaseResult
from uw_visibility_lab.evaluation.degrade import title_of
from uw_visibility_lab.evaluation.experiments import Evaluation
from uw_visibility_lab.evaluation.judging import HEAD, line_of, row_of
from uw_visibility_lab.evaluation.readings import OK, judged, reasons_text
from uw_visibility_lab.evaluation.survey import LAMPS, MEAN_ATTENUATION, PICTURES, SurveyResult
from uw_visibility_lab.evaluation.tables import (
    CHANNELS,
    as_text,
    flat,
    grouped,
    number,
    told,
    write_report,
)

Summary = dict[str, Any]
# Largest unmatched fractions in the paper's Fig. 6: 0.92 and 0.72 (conventional), 0.23 (its own).
SHARES = ("matched", "correct", "wrong")
"""Of all pixels, of those with known truth, and of the matched ones with known truth."""

CONDITIONS = (
    ("|α̂ − α|, 1/m", "mean_attenuation_error", 4),
    ("|ẑ − z|, m", "depth_error", 2),
    ("matched pixels", "matched", 3),
    ("correct disparities", "correct", 3),
    ("wrong among matched", "wrong", 3),
    ("ΔE*ab", "colour_difference", 1),
)
"""Tables by water and noise: title, key of `means`, decimals."""


def summarise(evaluation: Evaluation) -> Summary:
    """Reduce an evaluation to its summary; all but ``conditions`` is over cases without noise.

    Returns: ``water``: `judging.Row` by the names of `READINGS`; `means` over all cases, and
        ``conditions``: for each noise and water.
    """
    cases = evaluation.quiet
    conditions = grouped(evaluation.cases, lambda c: (
        # Without the rounding errors of adding and subtracting clear water's attenuation.
        c.noise, round(c.truth.mean_attenuation, 9), c.truth.depth))
    return {
        "cases": len(cases),
        "scenes": list(dict.fromkeys(case.scene for case in cases)),
        "water": {
            name: row_of([judged(c.truth, c.readings[name]) for c in cases])
            for name in READINGS},
        **means(cases),
        "conditions": [
            {"noise": noise, "mean_attenuation": attenuation, "depth": depth, **means(same)}
            for (noise, attenuation, depth), same in conditions.items()],
    }


def means(cases: Sequence[CaseResult]) -> Summary:
    """Return the mean errors of α and depth, of disparities and colours, by their names."""
    errors = {
        f"{what}_error": {
            name: mean(
                abs(getattr(c.readings[name], what) - getattr(c.truth, what)) for c in cases)
            for name in READINGS}
        for what in ("mean_attenuation", "depth")}
    return errors | {
        kind: {name: mean(getattr(case, kind)[name] for case in cases) for name in names}
        for kind, names in (
            *((share, MATCHES) for share in SHARES), ("colour_difference", IMAGES))}


def mean(values: Iterable[float]) -> float:
    """Return the mean of the finite values; NaN without any."""
    known = [value for value in values if math.isfinite(value)]
    return float(np.mean(known)) if known else math.nan


def write_evaluation(folder: Path, evaluation: Evaluation, summary: Summary) -> None:
    """Write the tables of an evaluation as CSV, and all of it in ``evaluation.json``."""
    in_json = {
        "cases": [case.row() for case in evaluation.cases],
        "reliability": [
            {"noise": noise, **row}
            for noise, rows in evaluation.reliability().items() for row in rows],
    }
    plan = evaluation.plan
    settings = {
        "scenes": [
            f"rendered, seed {source}" if isinstance(source, int) else source.name
            for source in plan.scenes],
        "attenuations": plan.attenuations,
        "depths": plan.depths,
        "noises": plan.noises,
        "parameters": told(plan.config),
    }
    write_report(
        folder, {**in_json, "conditions": [flat(each) for each in summary["conditions"]]},
        {"settings": settings, "summary": summary, **in_json})


def summary_text(evaluation: Evaluation, summary: Summary) -> str:
    """Return the summary as tables for a terminal."""
    conditions = [
        (f"α {each['mean_attenuation']:.3g} 1/m, z {each['depth']:g} m, "
         f"{title_of(each['noise'])}", each) for each in summary["conditions"]]
    conditions.append(("all without noise", summary))
    return "\n\n".join([
        f"{summary['cases']} cases: {', '.join(summary['scenes'])}",
        "\n".join([
            HEAD, *(line_of(READINGS[name], row) for name, row in summary["water"].items()),
            *(line for name, title in READINGS.items() for line in reasons_text(
                title, (case.readings[name] for case in evaluation.quiet)))]),
        *(as_text([title, *summary[kind]], [
            [words, *(number(value, digits) for value in each[kind].values())]
            for words, each in conditions]) for title, kind, digits in CONDITIONS),
    ])


def summarise_survey(survey: SurveyResult) -> Summary:
    """Return a survey's results, of single frames and of the filter over them (``pooled``).

    ``first_assessed``: number of frames until there is an estimate. ``attenuation_error``:
    relative, after the last frame. ``variation``, ``colour_difference``: by names of `PICTURES`.
    """
    truth, last = survey.truth, survey.pooled[-1]
    errors = np.array(last.attenuation) / np.array(truth.attenuation) - 1.0
    first = next((k + 1 for k, each in enumerate(survey.pooled) if each.status == OK), None)
    return {
        "frames": len(survey.pooled),
        "single": row_of([judged(truth, reading) for reading in survey.single]),
        "pooled": row_of([judged(truth, reading) for reading in survey.pooled]),
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


def survey_text(survey: SurveyResult, summary: Summary) -> str:
    """Return the summary as tables for a terminal."""
    errors = ", ".join(
        f"{name} {100 * error:+.0f} %" for name, error in summary["attenuation_error"].items())
    return "\n".join([
        f"survey of {summary['frames']} frames at night\n",
        HEAD,
        line_of("single frames", summary["single"]),
        line_of("with earlier frames", summary["pooled"]),
        *reasons_text("refused", survey.pooled),
        f"  error of β at the end: {errors} ({summary['last_status']})",
        as_text(["same reflectance over frames, σ/median [%]", "R", "G", "B", "ΔE*ab"], [
            [title, *(number(100.0 * summary["variation"][name][c], 1) for c in CHANNELS),
             number(summary["colour_difference"][name], 1)]
            for name, title in PICTURES.items()]),
    ])


def write_survey(
    folder: Path, config: PipelineConfig, survey: SurveyResult, summary: Summary
) -> None:
    """Write ``survey.csv`` and ``evaluation.json``."""
    frames = [
        flat({"frame": k, "true": survey.truth, "single": single, "pooled": pooled})
        for k, (single, pooled) in enumerate(zip(survey.single, survey.pooled, strict=True))]
    settings = {
        "frames": len(frames), "lamps": LAMPS, "mean_attenuation": MEAN_ATTENUATION,
        "parameters": told(config)}
    write_report(
        folder, {"survey": frames}, {"settings": settings, "summary": summary, "survey": frames})
