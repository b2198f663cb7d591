# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Summary and report of the experiments: tables, `evaluation.json`, and text for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
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


def summarise(evaluation: Evaluation) -> Summary:
    """Reduce an evaluation to its summary; all but ``noise`` is of cases without noise.

    Returns: ``water``: `statistics` by the names of `READINGS`; `means` over all cases,
        ``conditions``: for each water, and ``noise``: for each noise and α, at one depth;
        ``unmatched``: the largest share over turbidity, by scene and depth (Fig. 6).
    """
    cases, noisy, plan = evaluation.cases, evaluation.noisy, evaluation.plan
    waters = grouped(cases, lambda c: (_attenuation(c), c.truth.depth))
    shown = [case for case in cases if case.truth.depth == plan.shown[1]] if noisy else []
    noises = grouped([*shown, *noisy], lambda c: (c.noise, _attenuation(c)))
    order = ("0", *plan.noises)
    return {
        "cases": len(cases),
        "scenes": list(dict.fromkeys(case.scene for case in cases)),
        "water": by_estimate(cases),
        **means(cases),
        "conditions": [
            {"mean_attenuation": attenuation, "depth": depth, **means(same)}
            for (attenuation, depth), same in waters.items()],
        "unmatched": [
            {
                "scene": scene, "depth": depth,
                "largest": {name: max(1.0 - c.matched[name] for c in same) for name in MATCHES},
                "above_oracle": max(c.matched["oracle_ours"] - c.matched["ours"] for c in same),
            }
            for (scene, depth), same in grouped(
                cases, lambda c: (c.scene, c.truth.depth)).items()],
        "noise": [
            {"noise": noise, "mean_attenuation": attenuation, "depth": plan.shown[1],
             **means(noises[noise, attenuation])}
            for noise, attenuation in sorted(noises, key=lambda k: (order.index(k[0]), k[1]))],
    }


def _attenuation(case: CaseResult) -> float:
    # Without the rounding of what was added to clear water's and taken off again.
    return round(case.truth.mean_attenuation, 9)


def means(cases: Sequence[CaseResult]) -> Summary:
    """Return the mean error of α, and disparities and colours, by their names."""
    return {
        "mean_attenuation_error": {
            name: mean(
                abs(c.readings[name].mean_attenuation - c.truth.mean_attenuation) for c in cases)
            for name in READINGS
        },
        "disparity": {
            name: {
                "correct": mean(case.correct[name] for case in cases),
                "unmatched": mean(1.0 - case.matched[name] for case in cases),
                "wrong": mean(case.wrong[name] for case in cases),
            }
            for name in MATCHES
        },
        "colour_difference": {
            name: {
                "mean": mean(case.colour_difference[name] for case in cases),
                "assessed": sum(math.isfinite(case.colour_difference[name]) for case in cases),
            }
            for name in IMAGES
        },
    }


def write_evaluation(folder: Path, evaluation: Evaluation, summary: Summary) -> None:
    """Write the tables of an evaluation as CSV, and those of cases in ``evaluation.json``."""
    in_json = {
        "cases": [case.row() for case in evaluation.cases],
        "noisy_cases": [case.row() for case in evaluation.noisy],
        "reliability": [
            {"noise": noise, **row}
            for noise, of_noise in evaluation.reliability().items() for row in of_noise.rows()],
    }
    tables = {
        **in_json,
        "conditions": [flat(condition) for condition in summary["conditions"]],
        "noise": [flat(condition) for condition in summary["noise"]],
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
    write_report(folder, tables, {"settings": settings, "summary": summary, **in_json})


def summary_text(summary: Summary) -> str:
    """Return the summary as tables for a terminal."""
    water = [(READINGS[name], found) for name, found in summary["water"].items()]
    return "\n\n".join([
        f"{summary['cases']} cases: {', '.join(summary['scenes'])}\n{LEGEND}",
        "\n".join([
            statistics_text("estimates of the water", water),
            *(line for title, found in water for line in reasons_text(found, title))]),
        *_means(summary), *_conditions(summary), *_noise(summary["noise"])])


def _means(summary: Summary) -> list[str]:
    """Disparities and colours, means over all cases."""
    disparity, colour = summary["disparity"], summary["colour_difference"]
    return [
        as_text(["disparity, mean share of pixels", "correct", "unmatched"], [
            [title, number(disparity[name]["correct"], 3), number(disparity[name]["unmatched"], 3)]
            for name, title in MATCHES.items()]),
        as_text(["colour difference ΔE*ab to the scene in air", "mean", "of"], [
            [title, number(colour[name]["mean"], 2),
             f"{colour[name]['assessed']}/{summary['cases']}"]
            for name, title in IMAGES.items()]),
    ]


def _conditions(summary: Summary) -> list[str]:
    """Disparities and colours in each water, means over the scenes."""
    waters = [
        (f"α {found['mean_attenuation']:.3g} 1/m, z {found['depth']:g} m", found)
        for found in summary["conditions"]]
    return [
        as_text(["correct disparities", *SHORT_MATCHES], [
            [water, *_of(found["disparity"], "correct", 3)] for water, found in waters]),
        as_text(["ΔE*ab", *SHORT_IMAGES], [
            [water, *_of(found["colour_difference"], "mean", 1)] for water, found in waters]),
        "unmatched, largest over α (Fig. 6; the paper: 0.92 and 0.72 conventional, 0.23 its own)\n"
        + as_text(["", *SHORT_MATCHES, "above true w."], [
            [f"{found['scene']}, z {found['depth']:g} m",
             *(number(share, 3) for share in found["largest"].values()),
             number(found["above_oracle"], 3)]
            for found in summary["unmatched"]]),
    ]


def _of(methods: Summary, field: str, digits: int) -> Iterable[str]:
    return (number(found[field], digits) for found in methods.values())


def _noise(rows: Sequence[Summary]) -> list[str]:
    """Disparities and attenuation with noise, means over the scenes."""
    if not rows:
        return []
    return [f"noise at z = {rows[0]['depth']:g} m\n" + as_text(
        ["", *SHORT_MATCHES, "|α̂ − α|"], [
            [f"α {row['mean_attenuation']:.3g} 1/m, {title_of(row['noise'])}: {words}",
             *_of(row["disparity"], what, 3),
             number(row["mean_attenuation_error"]["pipeline"], 4) if what == "correct" else ""]
            for row in rows
            for what, words in (("correct", "correct"), ("wrong", "wrong among matched"))])]
