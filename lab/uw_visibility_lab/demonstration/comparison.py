# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the node's answers with the truth, frame by frame, and its pictures."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uw_visibility.config.schema import AssessmentConfig
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.images.files import write_png
from uw_visibility.images.overview import overview
from uw_visibility.messages.images import read_disparity, read_image
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility_lab.demonstration.recording import RecordedFrame
from uw_visibility_lab.evaluation.figures.style import OURS, TRUTH_STYLE, save
from uw_visibility_lab.evaluation.metrics import correct_fraction, matched_fraction
from uw_visibility_lab.evaluation.tables import as_csv

NAN = math.nan
CORRECT = 1.0
"""Largest error in px of a correct disparity."""

QUANTITIES = {
    "mean_attenuation": "mean attenuation α [1/m]",
    "visibility_distance": "visibility distance [m]",
    "depth": "depth [m]",
}

READ: dict[str, tuple[str, Callable[[Any], float]]] = {
    "mean_attenuation": ("visibility/mean_attenuation_stamped", lambda m: m.vector.x),
    "mean_attenuation_stddev": ("visibility/mean_attenuation_stamped", lambda m: m.vector.y),
    "visibility_distance": ("visibility/distance", lambda m: m.range),
    "visibility_distance_stddev": ("visibility/distance", lambda m: math.sqrt(m.variance)),
    "depth": ("visibility/depth", lambda m: -m.pose.pose.position.z),
    "depth_stddev": ("visibility/depth", lambda m: math.sqrt(m.pose.covariance[14])),
}
"""Topic of each estimate, and how it is read from the message."""


@dataclass(frozen=True)
class FrameComparison:
    """One frame's estimates and truth, a row of the table; NaN = not assessed.

    Lengths are in m, attenuations in 1/m, times in s, the latency in ms.
    Matched and correct are shares of the pixels that have a true disparity.
    """

    time: float
    answered: bool
    latency: float = NAN
    mean_attenuation: float = NAN
    mean_attenuation_stddev: float = NAN
    true_mean_attenuation: float = NAN
    visibility_distance: float = NAN
    visibility_distance_stddev: float = NAN
    true_visibility_distance: float = NAN
    depth: float = NAN
    depth_stddev: float = NAN
    true_depth: float = NAN
    matched_before: float = NAN
    correct_before: float = NAN
    matched_after: float = NAN
    correct_after: float = NAN


def compare(
    frame: RecordedFrame, time: float, answer: Mapping[str, Any], latency: float,
    before: DisparityMap,
) -> FrameComparison:
    """Compare the node's answer to a frame with the truth.

    time: from the first frame in s.
    answer: the node's messages by topic; empty where it did not answer.
    latency: from the images' stamp to the last of these messages in ms.
    before: (H, W); disparity of the raw pair, px; NaN = unmatched.
    """
    found = {name: take(answer[topic]) for name, (topic, take) in READ.items() if topic in answer}
    found["matched_before"], found["correct_before"] = score(before, frame.disparity)
    if "disparity" in answer:
        after = score(read_disparity(answer["disparity"]), frame.disparity)
        found["matched_after"], found["correct_after"] = after
    return FrameComparison(
        time, bool(answer), latency,
        true_mean_attenuation=frame.mean_attenuation,
        true_visibility_distance=visibility_distance(
            float(frame.attenuation.min()), AssessmentConfig().contrast),
        true_depth=frame.depth, **found,
    )


def score(disparity: DisparityMap, truth: DisparityMap) -> tuple[float, float]:
    """Return the matched and the correct share of the pixels that have a true disparity."""
    matched = matched_fraction(disparity[np.isfinite(truth)])
    return matched, correct_fraction(disparity, truth, CORRECT)


def summarize(rows: Sequence[FrameComparison]) -> dict[str, str]:
    """Return the summary for the terminal: values by name, over the frames that were answered."""
    answered = [row for row in rows if row.answered]

    def over(
        value: Callable[[FrameComparison], float], form: str,
        take: Callable[[Sequence[float]], float] = statistics.fmean,
    ) -> str:
        kept = [v for v in map(value, answered) if math.isfinite(v)]
        return form.format(take(kept)) if kept else "not assessed"

    return {
        "frames in": str(len(rows)),
        "frames out": str(len(answered)),
        "of these assessed": str(sum(math.isfinite(r.mean_attenuation) for r in answered)),
        "mean absolute error of alpha": over(
            lambda r: abs(r.mean_attenuation - r.true_mean_attenuation), "{:.3f} 1/m"),
        "mean absolute error of depth": over(lambda r: abs(r.depth - r.true_depth), "{:.2f} m"),
        "matched, before enhancement": over(lambda r: r.matched_before, "{:.3f}"),
        "matched, after": over(lambda r: r.matched_after, "{:.3f}"),
        "correct (<= 1 px), before": over(lambda r: r.correct_before, "{:.3f}"),
        "correct (<= 1 px), after": over(lambda r: r.correct_after, "{:.3f}"),
        "median latency, image to last result": over(
            lambda r: r.latency, "{:.0f} ms", statistics.median),
    }


def write_results(folder: Path, rows: Sequence[FrameComparison]) -> None:
    """Write ``frames.csv``, a row for each frame, and ``series.png``, estimates over time."""
    table = [
        {name: int(value) if isinstance(value, bool) else float(f"{value:.6g}")
         for name, value in vars(row).items()}
        for row in rows
    ]
    (folder / "frames.csv").write_text(as_csv(table), encoding="utf-8")
    _draw_series(folder / "series.png", rows)


def _draw_series(path: Path, rows: Sequence[FrameComparison]) -> None:
    """Draw estimates over time (s) with bands of 1 and 2 σ and the truth, a panel for each."""
    figure = Figure(figsize=(9.0, 8.2), layout="constrained")
    grid = figure.subplots(len(QUANTITIES), 1, sharex=True)
    time = np.array([row.time for row in rows])
    for axes, (name, label) in zip(grid, QUANTITIES.items(), strict=True):
        value, sigma, truth = (
            np.array([getattr(row, field) for row in rows])
            for field in (name, f"{name}_stddev", f"true_{name}"))
        for factor, opacity in ((2, 0.13), (1, 0.25)):
            axes.fill_between(
                time, value - factor * sigma, value + factor * sigma, color=OURS, alpha=opacity,
                linewidth=0.0, label=f"± {factor} σ",
            )
        axes.plot(
            time, value, "o-", color=OURS, markersize=3.5, linewidth=1.2, label="each frame alone")
        axes.plot(time, truth, **TRUTH_STYLE)
        axes.set_ylabel(label)
        # A wild estimate does not set the limits.
        axes.set_ylim(0.0, 2.0 * truth.max())
        axes.grid(alpha=0.25)
        missing = time[~np.isfinite(value)]
        if missing.size:
            axes.plot(
                missing, np.zeros(missing.size), "|", color="#cc2020", markersize=9.0,
                transform=axes.get_xaxis_transform(), clip_on=False, label="not assessed",
            )
    grid[-1].set_xlabel("time [s]")
    handles: dict[str, object] = {}
    for axes in grid:
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center", ncols=6, frameon=False)
    figure.suptitle("Estimates of the node over the transect")
    save(figure, path)


def draw_frame(
    path: Path, frame: RecordedFrame, answer: Mapping[str, Any], row: FrameComparison
) -> None:
    """Draw one frame: raw and enhanced image, range, and numbers."""
    ranges = frame.rig.range_from_disparity(read_disparity(answer["disparity"]))
    words = [f"time {row.time:.1f} s, latency {row.latency:.0f} ms"]
    for name in QUANTITIES:
        value, stddev, truth = (
            getattr(row, field) for field in (name, f"{name}_stddev", f"true_{name}"))
        estimate = f"{value:.3f} +- {stddev:.3f}" if math.isfinite(value) else "not assessed"
        words.append(f"{name.replace('_', ' ')} {estimate}, truth {truth:.3f}")
    words.append(
        f"disparities matched {row.matched_before:.0%} before, {row.matched_after:.0%} after; "
        f"correct {row.correct_before:.0%} before, {row.correct_after:.0%} after")
    write_png(path, overview(
        frame.left, read_image(answer["left/enhanced/image"]), ranges, "; ".join(words),
        frame.rig.range_error()))
