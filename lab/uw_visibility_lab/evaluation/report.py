# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Report of the experiments: tables, `evaluation.json`, and text for the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from uw_visibility_lab.evaluation.cases import IMAGES, MATCHES, READINGS
from uw_visibility_lab.evaluation.degrade import title_of
from uw_visibility_lab.evaluation.experiments import Evaluation
from uw_visibility_lab.evaluation.summary import TURBID, Summary
from uw_visibility_lab.evaluation.tables import as_text, flat, number, told, write_report

# Places that are printed for one reason; evaluation.json has them all.
PLACES_SHOWN = 4
SHORT_MATCHES = ("SGBM", "CLAHE+", "oracle+", "ours raw", "ours", "true w.")
SHORT_IMAGES = ("input", "hist.", "CLAHE", "step 1", "final", "oracle")


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
    parts: list[str] = []
    if summary["cases"]:
        parts += [f"{summary['cases']} cases: {', '.join(summary['scenes'])}"]
        parts += [*_water(summary["water"]), *_means(summary), *_conditions(summary)]
        parts += [*_noise(summary["noise"]), _not_assessed(summary["water"])]
    return "\n\n".join(parts)


def _water(water: Summary) -> list[str]:
    tables = [
        as_text([title, "mean", "worst", "assessed", "worst at"], [
            [READINGS[name], *_errors(water[name][field], digits)] for name in names])
        for title, field, names, digits in (
            ("mean attenuation |α̂ − α| [1/m]", "mean_attenuation_error", READINGS, 4),
            (f"visibility distance, relative, α ≥ {TURBID:g}", "distance_relative_error_turbid",
             ("pipeline", "exact"), 3),
            ("depth |ẑ − z| [m]", "depth_error", ("pipeline", "exact"), 3),
        )
    ]
    within = {name: water[name]["attenuation_within"] for name in ("pipeline", "exact")}
    tables.append(as_text(["normalised errors of β within", "1 σ", "2 σ", "of"], [
        [READINGS[name], number(found["1_sigma"], 2), number(found["2_sigma"], 2),
         str(found["of"])]
        for name, found in within.items()]))
    return tables


def _errors(errors: Summary, digits: int) -> list[str]:
    return [number(errors["mean"], digits), number(errors["worst"], digits),
            f"{errors['assessed']}/{errors['of']}", errors["worst_at"] or ""]


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


def _not_assessed(water: Summary) -> str:
    lines = []
    for name, title in READINGS.items():
        known = water[name]["not_assessed"]
        for what in ("", "distance", "depth"):
            for reason, places in water[name][f"{what}_not_assessed".lstrip("_")].items():
                # What stops the estimate stops the rest: only what is lacking beyond it is new.
                more = [place for place in places if not what or place not in known.get(reason, ())]
                if more:
                    subject = f"{what}, {title}" if what else title
                    shown = "; ".join(more[:PLACES_SHOWN])
                    if len(more) > PLACES_SHOWN:
                        shown += f"; and {len(more) - PLACES_SHOWN} more"
                    lines.append(f"  {subject}: {reason}, {len(more)} x: {shown}")
    return "\n".join(["not assessed" if lines else "not assessed: none", *lines])

