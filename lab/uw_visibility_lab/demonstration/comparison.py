# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the node's answers with the truth, frame by frame, and its pictures."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from uw_visibility.config.schema import AssessmentConfig
from uw_visibility.images.arrays import Array, DisparityMap, Image8
from uw_visibility.images.files import write_png
from uw_visibility.images.overview import overview
from uw_visibility.messages.images import read_disparity, read_image
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility.stereo.rig import StereoRig
from uw_visibility_lab.demonstration.client import Answer
from uw_visibility_lab.evaluation.metrics import correct_fraction, matched_fraction
from uw_visibility_lab.evaluation.style import OURS, TRUTH_STYLE, save
from uw_visibility_lab.evaluation.tables import as_csv

NAN = math.nan

QUANTITIES: dict[str, tuple[str, str, Callable[[Any], tuple[float, float]]]] = {
    "mean_attenuation": (
        "mean attenuation α [1/m]", "visibility/mean_attenuation_stamped",
        lambda m: (m.vector.x, m.vector.y)),
    "visibility_distance": (
        "visibility distance [m]", "visibility/distance", lambda m: (m.range, m.variance**0.5)),
    "depth": (
        "depth [m]", "visibility/depth",
        lambda m: (-m.pose.pose.position.z, m.pose.covariance[14]**0.5)),
}
"""Label and topic of each estimate, and how it and its deviation are read from the message."""

Row = Mapping[str, float]
"""One frame's estimates and truth, see `compare`."""


class Truth(NamedTuple):
    """Parts of a rendered frame for the comparison; see `RenderedFrame`."""

    time: float  # from the first frame in s
    left: Image8
    right: Image8
    attenuation: Array
    mean_attenuation: float
    depth: float
    disparity: DisparityMap  # of the left image


def compare(frame: Truth, answer: Answer, before: DisparityMap) -> Row:
    """Compare the node's answer to a frame with the truth.

    before: (H, W); disparity of the raw pair, px; NaN = unmatched.
    Returns a row of the table; NaN = not assessed. Lengths are in m, attenuations in 1/m. Matched
        and correct are shares of the pixels that have a true disparity.
    """
    truth = {
        "mean_attenuation": frame.mean_attenuation,
        "visibility_distance": visibility_distance(
            float(frame.attenuation.min()), AssessmentConfig().contrast),
        "depth": frame.depth,
    }
    messages = answer.messages
    row: dict[str, float] = {
        "time": frame.time, "answered": int(bool(messages)), "latency": answer.latency}
    for name, (_, topic, read) in QUANTITIES.items():
        row[name], row[f"{name}_stddev"] = (
            read(messages[topic]) if topic in messages else (NAN, NAN))
        row[f"true_{name}"] = truth[name]
    row["matched_before"], row["correct_before"] = score(before, frame.disparity)
    row["matched_after"], row["correct_after"] = (
        score(read_disparity(messages["disparity"]), frame.disparity) if "disparity" in messages
        else (NAN, NAN))
    return row


def score(disparity: DisparityMap, truth: DisparityMap) -> tuple[float, float]:
    """Return the matched and the correct share of the pixels that have a true disparity."""
    matched = matched_fraction(disparity[np.isfinite(truth)])
    return matched, correct_fraction(disparity, truth)


def summarize(rows: Sequence[Row]) -> dict[str, str]:
    """Return the summary for the terminal: values by name, over the frames that were answered."""
    answered = [row for row in rows if row["answered"]]

    def over(
        values: Iterable[float], form: str,
        take: Callable[[Sequence[float]], float] = statistics.fmean,
    ) -> str:
        kept = [value for value in values if math.isfinite(value)]
        return form.format(take(kept)) if kept else "not assessed"

    def error(name: str) -> Iterable[float]:
        return (abs(row[name] - row[f"true_{name}"]) for row in answered)

    shares = {
        "matched, before enhancement": "matched_before", "matched, after": "matched_after",
        "correct (<= 1 px), before": "correct_before", "correct (<= 1 px), after": "correct_after"}
    return {
        "frames in": str(len(rows)),
        "frames out": str(len(answered)),
        "of these assessed": str(sum(math.isfinite(r["mean_attenuation"]) for r in answered)),
        "mean absolute error of alpha": over(error("mean_attenuation"), "{:.3f} 1/m"),
        "mean absolute error of depth": over(error("depth"), "{:.2f} m"),
        **{title: over((r[name] for r in answered), "{:.3f}") for title, name in shares.items()},
        "median latency, image to last result": over(
            (row["latency"] for row in answered), "{:.0f} ms", statistics.median),
    }


def write_results(folder: Path, rows: Sequence[Row]) -> None:
    """Write ``frames.csv``, a row for each frame, and ``series.png``, estimates over time."""
    table = [
        {name: value if isinstance(value, int) else float(f"{value:.6g}")
         for name, value in row.items()}
        for row in rows
    ]
    (folder / "frames.csv").write_text(as_csv(table), encoding="utf-8")
    _draw_series(folder / "series.png", rows)


def _draw_series(path: Path, rows: Sequence[Row]) -> None:
    """Draw estimates over time (s) with bands of 1 and 2 σ and the truth, a panel for each."""
    figure = Figure(figsize=(9.0, 8.2), layout="constrained")
    grid = figure.subplots(len(QUANTITIES), 1, sharex=True)
    time = np.array([row["time"] for row in rows])
    answered = np.array([bool(row["answered"]) for row in rows])
    for axes, (name, (label, *_)) in zip(grid, QUANTITIES.items(), strict=True):
        value, sigma, truth = (
            np.array([row[field] for row in rows])
            for field in (name, f"{name}_stddev", f"true_{name}"))
        for factor, opacity in ((2, 0.13), (1, 0.25)):
            axes.fill_between(
                time, value - factor * sigma, value + factor * sigma, color=OURS, alpha=opacity,
                linewidth=0.0, label=f"± {factor} σ",
            )
        axes.plot(
            time, value, "o-", color=OURS, markersize=3.5, linewidth=1.2,
            label="filtered over frames")
        axes.plot(time, truth, **TRUTH_STYLE)
        axes.set_ylabel(label)
        # Outliers do not set the limits.
        axes.set_ylim(0.0, 2.0 * truth.max())
        axes.grid(alpha=0.25)
        for label, missing, color in (
            ("not answered", ~answered, "#808080"),
            ("not assessed", answered & ~np.isfinite(value), "#cc2020"),
        ):
            if missing.any():
                axes.plot(
                    time[missing], np.zeros(missing.sum()), "|", color=color, markersize=9.0,
                    transform=axes.get_xaxis_transform(), clip_on=False, label=label)
    grid[-1].set_xlabel("time [s]")
    handles: dict[str, object] = {}
    for axes in grid:
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center", ncols=7, frameon=False)
    figure.suptitle("Estimates of the node over the transect")
    save(figure, path)


def draw_frame(
    path: Path, raw: Image8, messages: Mapping[str, Any], rig: StereoRig, row: Row
) -> None:
    """Draw one frame: raw and enhanced image, range, and numbers."""
    ranges = rig.range_from_disparity(read_disparity(messages["disparity"]))
    words = [f"time {row['time']:.1f} s, latency {row['latency']:.0f} ms"]
    for name, (label, *_) in QUANTITIES.items():
        value, stddev, truth = (
            row[field] for field in (name, f"{name}_stddev", f"true_{name}"))
        unit = label.partition("[")[2].removesuffix("]")
        digits = 1 if unit == "m" else 3
        estimate = (
            f"{value:.{digits}f} +- {stddev:.{digits}f} {unit}" if math.isfinite(value)
            else "not assessed")
        words.append(f"{name.replace('_', ' ')} {estimate}, truth {truth:.{digits}f}")
    words.append(
        "disparities matched {matched_before:.0%} before, {matched_after:.0%} after; correct "
        "{correct_before:.0%} before, {correct_after:.0%} after".format_map(row))
    write_png(path, overview(
        raw, read_image(messages["left/enhanced/image"]), ranges, "; ".join(words),
        rig.range_error()))
