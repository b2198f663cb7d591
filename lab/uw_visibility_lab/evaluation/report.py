# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Summary and report of the experiments: tables, `evaluation.json`, and text for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from uw_visibility_lab.evaluation.cases import IMAGES, MATCHES, READINGS, CaseResult
from uw_visibility_lab.evaluation.degrade import title_of
from uw_visibility_lab.evaluation.experiments import Evaluation
from uw_visibility_lab.evaluation.studies import (
    LEGEND,
    Summary,
    by_estimate,
    grouped,
    mean,
    reasons_text,
    statistics_text,
)
from uw_visibility_lab.evaluation.tables import as_text, flat, number, told, write_report

SHORT_MATCHES = ("SGBM", "CLAHE+", "oracle+", "ours raw", "ours", "true w.")
SHORT_IMAGES = ("input", "hist.", "CLAHE", "step 1", "final", "oracle")
SHORT_READINGS = ("step 1", "ours", "exact", "plain", "plain, exact")
# The paper's Fig. 6 has 0.92 and 0.72 unmatched at most by a conventional matcher, 0.23 by its own.
SHARES = ("matched", "correct", "wrong")
"""Of all pixels, of those with known truth, and of the matched ones with known truth."""

CONDITIONS = (
    ("|α̂ − α|, 1/m", "mean_attenuation_error", SHORT_READINGS, 4),
    ("matched pixels", "matched", SHORT_MATCHES, 3),
    ("correct disparities", "correct", SHORT_MATCHES, 3),
    ("wrong among matched", "wrong", SHORT_MATCHES, 3),
    ("ΔE*ab", "colour_difference", SHORT_IMAGES, 1),
)
"""Tables of each water and noise: title, what of `means`, headings, decimals."""


def summarise(evaluation: Evaluation) -> Summary:
    """Reduce an evaluation to its summary; all but ``conditions`` is of cases without noise.

    Returns: ``water``: `statistics` by the names of `READINGS`; `means` over all cases, and
        ``conditions``: for each noise and water.
    """
    cases = evaluation.quiet
    conditions = grouped(evaluation.cases, lambda c: (
        # Without the rounding of what was added to clear water's and taken off again.
        c.noise, round(c.truth.mean_attenuation, 9), c.truth.depth))
    return {
        "cases": len(cases),
        "scenes": list(dict.fromkeys(case.scene for case in cases)),
        "water": by_estimate(cases),
        **means(cases),
        "conditions": [
            {"noise": noise, "mean_attenuation": attenuation, "depth": depth, **means(same)}
            for (noise, attenuation, depth), same in conditions.items()],
    }


def means(cases: Sequence[CaseResult]) -> Summary:
    """Return the mean error of α, and those of disparities and colours, by their names."""
    return {
        "mean_attenuation_error": {
            name: mean(
                abs(c.readings[name].mean_attenuation - c.truth.mean_attenuation) for c in cases)
            for name in READINGS
        },
        **{
            kind: {name: mean(getattr(case, kind)[name] for case in cases) for name in names}
            for kind, names in (*((share, MATCHES) for share in SHARES),
                                ("colour_difference", IMAGES))},
    }


def write_evaluation(folder: Path, evaluation: Evaluation, summary: Summary) -> None:
    """Write the tables of an evaluation as CSV, and those of cases in ``evaluation.json``."""
    in_json = {
        "cases": [case.row() for case in evaluation.cases],
        "reliability": [
            {"noise": noise, **row}
            for noise, rows in evaluation.reliability().items() for row in rows],
    }
    plan = evaluation.plan
    settings = {
        "scenes": [
            f"rendered, seed {source.seed}" if source.folder is None else source.folder.name
            for source in plan.scenes],
        "attenuations": plan.attenuations,
        "depths": plan.depths,
        "noises": plan.noises,
        "parameters": told(plan.config),
    }
    write_report(
        folder, {**in_json, "conditions": [flat(each) for each in summary["conditions"]]},
        {"settings": settings, "summary": summary, **in_json})


def summary_text(summary: Summary) -> str:
    """Return the summary as tables for a terminal."""
    water = [(READINGS[name], found) for name, found in summary["water"].items()]
    conditions = [
        (f"α {each['mean_attenuation']:.3g} 1/m, z {each['depth']:g} m, "
         f"{title_of(each['noise'])}", each) for each in summary["conditions"]]
    return "\n\n".join([
        f"{summary['cases']} cases: {', '.join(summary['scenes'])}\n{LEGEND}",
        "\n".join([
            statistics_text("estimates of the water", water),
            *(line for title, found in water for line in reasons_text(found, title))]),
        as_text(["disparity, mean share of pixels", *SHARES], [
            [title, *(number(summary[share][name], 3) for share in SHARES)]
            for name, title in MATCHES.items()]),
        as_text(["colour difference to the scene in air", "ΔE*ab"], [
            [title, number(summary["colour_difference"][name], 2)]
            for name, title in IMAGES.items()]),
        *(as_text([title, *short], [
            [words, *(number(value, digits) for value in each[kind].values())]
            for words, each in conditions]) for title, kind, short, digits in CONDITIONS),
    ])
