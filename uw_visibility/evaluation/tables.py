# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Tables of an evaluation, as CSV and JSON; numbers as text, in which a dash is not known."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.evaluation.experiments import Evaluation
from uw_visibility.evaluation.readings import flat
from uw_visibility.evaluation.summary import Summary
from uw_visibility.simulation.transect import Transect

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

UNKNOWN = "–"


def write_tables(folder: Path, evaluation: Evaluation, summary: Summary) -> None:
    """Write the tables as CSV, and all of them as JSON.

    What is not assessable is an empty field of a CSV file and null in JSON.
    """
    cases = [case.row() for case in evaluation.cases]
    transect = [row.row() for row in evaluation.transect]
    conditions = [flat(condition) for condition in summary["conditions"]]
    noise = [flat(condition) for condition in summary["noise"]]
    noisy = [case.row() for case in evaluation.noisy]
    edges = [
        {"scene": case.scene, **error.row()} for case in evaluation.cases for error in case.edges
    ]
    reliability = [
        {"noise": noise, **row}
        for noise, of_noise in evaluation.reliability().items() for row in of_noise.rows()
    ]
    write_rows(folder, {
        "cases": cases, "conditions": conditions, "noisy_cases": noisy, "noise": noise,
        "edges": edges, "reliability": reliability, "transect": transect,
    })
    # In a file of their own: times differ from run to run, nothing else does.
    write_rows(folder, {"table1": timing_rows(
        [case.timing_ms for case in evaluation.cases if case.timing_ms])})
    plan = evaluation.plan
    report = {
        "settings": {
            "scenes": [
                f"rendered, seed {source.seed}" if source.folder is None else source.folder.name
                for source in plan.scenes
            ],
            "attenuations": plan.attenuations,
            "depths": plan.depths,
            "noises": plan.noises,
            "transect": None if plan.transect is None else _of_transect(plan.transect),
            "parameters": told(plan.config),
        },
        "summary": summary,
        "cases": cases,
        "noisy_cases": noisy,
        "reliability": reliability,
        "transect": transect,
    }
    write_report(folder, report)


def told(config: PipelineConfig) -> dict[str, Any]:
    """Return the parameters that a study tells the pipeline.

    The number of threads changes nothing in the result.
    """
    return {name: value for name, value in config.to_parameters().items() if name != "threads"}


def write_report(folder: Path, report: Mapping[str, Any]) -> None:
    """Write what a study found as ``evaluation.json``; what is not finite is null."""
    text = json.dumps(plain(report), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "evaluation.json").write_text(text + "\n", encoding="utf-8")


def plain(value: Any) -> Any:
    """Return nested values in JSON's types; what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (bool, str)) or value is None:
        return value
    if float(value).is_integer() and not isinstance(value, float):
        return int(value)
    return float(value) if math.isfinite(value) else None


def write_rows(folder: Path, tables: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Write tables as CSV by their names; those without rows are left out."""
    for name, rows in tables.items():
        if rows:
            (folder / f"{name}.csv").write_text(as_csv(rows), encoding="utf-8")


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows as CSV text with a header; what is not finite is an empty field."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(plain(row) for row in rows)
    return stream.getvalue()


def _of_transect(plan: Transect) -> dict[str, Any]:
    return {
        "frames": plan.frames, "width": plan.camera.width, "height": plan.camera.height,
        "marine_snow": plan.effects.marine_snow, "caustics": plan.effects.caustics,
        "seed": plan.seed,
    }


def timing_rows(timings: Sequence[Mapping[str, float]]) -> list[dict[str, Any]]:
    """Return mean and standard deviation of each step's time.

    Parameters
    ----------
    timings : sequence of mapping
        Durations of stages in ms, of each case; two stages may overlap, so that the
        total is less than their sum.

    Returns
    -------
    list of dict
        ``step``, ``median_ms``, ``mean_ms``, ``stddev_ms``, ``paper_mean_ms``; empty without
        cases. The first case of a process loads kernels and allocates, which the median
        does not see.
    """
    if not timings:
        return []
    steps = {
        step: (paper, [sum(case.get(stage, 0.0) for stage in stages) for case in timings])
        for step, (paper, stages) in TABLE_I.items()
    }
    # The pair as recorded is matched for comparison alone.
    steps["total"] = TOTAL_OF_PAPER, [
        case["total"] - case.get("original disparity", 0.0) for case in timings]
    return [
        {"step": step, "median_ms": float(np.median(values)), "mean_ms": float(np.mean(values)),
         "stddev_ms": float(np.std(values)), "paper_mean_ms": paper}
        for step, (paper, values) in steps.items()
    ]


def number(value: float | None, digits: int) -> str:
    """Return a number with so many decimals."""
    return UNKNOWN if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def percent(share: float) -> str:
    """Return a share in percent."""
    return UNKNOWN if not math.isfinite(share) else f"{100 * share:.0f}"
