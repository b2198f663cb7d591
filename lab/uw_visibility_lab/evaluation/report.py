# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Report of the experiments: tables, `evaluation.json`, and text for the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility_lab.evaluation.cases import IMAGES, MATCHES, READINGS
from uw_visibility_lab.evaluation.degrade import title_of
from uw_visibility_lab.evaluation.experiments import Evaluation
from uw_visibility_lab.evaluation.methods import of_kind
from uw_visibility_lab.evaluation.summary import TURBID, Summary
from uw_visibility_lab.evaluation.tables import as_text, flat, number, told, write_report
from uw_visibility_lab.simulation.transect import Transect

TABLE_I = {
    "sparse disparity mesh": (
        117.1, ("gain and foreground", "reduction", "support points", "coarse disparity")),
    "visibility estimation (step 1)": (613.9, ("visibility estimation 1",)),
    "image enhancement L (step 1)": (314.9, ("matting", "image enhancement 1")),
    "improved disparity": (770.5, ("improved disparity", "full size", "interpolation")),
    "visibility estimation (step 2)": (566.9, ("visibility estimation 2",)),
    "image enhancement (step 2)": (182.2, ("image enhancement 2", "assessment")),
}
"""Mean time in ms in the paper (640x480, one processor of 2.4 GHz, MATLAB), and our stages."""
TOTAL_OF_PAPER = 2565.5

# Places that are printed for one reason; evaluation.json has them all.
PLACES_SHOWN = 4
TRANSECT = {"pipeline": "each frame alone", "tracked": "filtered", "exact": "exact ranges"}
SHORT_MATCHES = (
    "SGBM", "CLAHE+", "oracle+", "ours raw", "ours", "true w.",
    *(name[:8] for name in of_kind("matcher")),
)
SHORT_IMAGES = (
    "input", "hist.", "CLAHE", "step 1", "final", "oracle",
    *(name[:6] for name in of_kind("restorer")),
)


def write_evaluation(folder: Path, evaluation: Evaluation, summary: Summary) -> None:
    """Write the tables of an evaluation as CSV, and most of them in ``evaluation.json``."""
    in_json = {
        "cases": [case.row() for case in evaluation.cases],
        "noisy_cases": [case.row() for case in evaluation.noisy],
        "reliability": [
            {"noise": noise, **row}
            for noise, of_noise in evaluation.reliability().items() for row in of_noise.rows()],
        "transect": [row.row() for row in evaluation.transect],
    }
    tables = {
        **in_json,
        "conditions": [flat(condition) for condition in summary["conditions"]],
        "noise": [flat(condition) for condition in summary["noise"]],
        # Not in the JSON file: times differ from run to run, nothing else does.
        "table1": timing_rows([case.timing_ms for case in evaluation.cases if case.timing_ms]),
    }
    plan = evaluation.plan
    settings = {
        "scenes": [
            f"rendered, seed {source.seed}" if source.folder is None else source.folder.name
            for source in plan.scenes],
        "attenuations": plan.attenuations,
        "depths": plan.depths,
        "noises": plan.noises,
        "transect": None if plan.transect is None else _of_transect(plan.transect),
        "parameters": told(plan.config),
    }
    write_report(folder, tables, {"settings": settings, "summary": summary, **in_json})


def _of_transect(plan: Transect) -> dict[str, Any]:
    return {
        "frames": plan.frames, "width": plan.camera.width, "height": plan.camera.height,
        "marine_snow": plan.effects.marine_snow, "caustics": plan.effects.caustics,
        "seed": plan.seed,
    }


def timing_rows(timings: Sequence[Mapping[str, float]]) -> list[dict[str, Any]]:
    """Return median, mean and standard deviation of each step's time, beside the paper's mean.

    timings: durations of stages in ms, of each case; two stages may overlap, so that the total is
        less than their sum. The first case of a process loads kernels and allocates, which the
        median does not see.
    """
    if not timings:
        return []
    steps = {
        step: (paper, [sum(case.get(stage, 0.0) for stage in stages) for case in timings])
        for step, (paper, stages) in TABLE_I.items()
    }
    # The raw pair is matched for comparison only.
    steps["total"] = TOTAL_OF_PAPER, [
        case["total"] - case.get("original disparity", 0.0) for case in timings]
    return [
        {"step": step, "median_ms": float(np.median(values)), "mean_ms": float(np.mean(values)),
         "stddev_ms": float(np.std(values)), "paper_mean_ms": paper}
        for step, (paper, values) in steps.items()
    ]


def summary_text(summary: Summary) -> str:
    """Return the summary as tables for a terminal."""
    parts: list[str] = []
    if summary["cases"]:
        parts += [f"{summary['cases']} cases: {', '.join(summary['scenes'])}"]
        parts += [*_water(summary["water"]), *_means(summary), *_conditions(summary)]
        parts += [*_noise(summary["noise"]), _not_assessed(summary["water"])]
    if summary["transect"] is not None:
        parts.append(_transect(summary["transect"]))
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


def _transect(transect: Summary) -> str:
    rows, lines = [], []
    for name, how in TRANSECT.items():
        found = transect[name]
        for field, title, digits in (
            ("mean_attenuation_error", "|α̂ − α| [1/m]", 4),
            ("distance_relative_error", "visibility distance, relative", 3),
            ("depth_error", "|ẑ − z| [m]", 3),
        ):
            rows.append([f"{title}, {how}", *_errors(found[field], digits)])
        shares = " / ".join(
            number(found["mean_attenuation_within"][f"{k}_sigma"], 2) for k in (1, 2, 3))
        lines += [
            f"  α within 1 / 2 / 3 σ, {how}: {shares}",
            f"  error of α from frame to frame, rms, {how}: "
            f"{number(found['frame_to_frame'], 4)} 1/m",
            *(f"  not assessed, {how}: {reason}, {len(places)} x"
              for reason, places in found["not_assessed"].items()),
        ]
    head = [f"transect of {transect['frames']} frames", "mean", "worst", "assessed", "worst at"]
    return "\n".join([as_text(head, rows), *lines])
