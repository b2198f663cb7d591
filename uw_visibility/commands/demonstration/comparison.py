# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the node's answers with the truth, frame by frame."""

from __future__ import annotations

import csv
import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.commands.demonstration.recording import RecordedFrame, read_vector
from uw_visibility.config.schema import AssessmentConfig
from uw_visibility.evaluation.metrics import correct_fraction, matched_fraction
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.messages.images import read_disparity
from uw_visibility.optics.light_model import visibility_distance

NAN = math.nan
CORRECT = 1.0
"""Largest error in px of a correct disparity."""


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
    frame: RecordedFrame,
    time: float,
    answer: Mapping[str, Any],
    latency: float,
    before: DisparityMap,
) -> FrameComparison:
    """Compare the node's answer to a frame with the truth.

    Parameters
    ----------
    frame : RecordedFrame
        Input and truth.
    time : float
        Time from the first frame in s.
    answer : mapping of str to object
        The node's messages by topic; empty where it did not answer.
    latency : float
        From the images' stamp to the last of these messages in ms.
    before : ndarray, shape (H, W), float32
        Disparity of the raw pair, px; NaN = unmatched.
    """
    estimates: dict[str, float] = {}
    if "visibility/mean_attenuation" in answer:
        estimates["mean_attenuation"] = answer["visibility/mean_attenuation"].data
    if "visibility/attenuation_stddev" in answer:
        # Of the mean of three channels whose errors are alike: ranges and light are common.
        stddev = read_vector(answer["visibility/attenuation_stddev"])
        estimates["mean_attenuation_stddev"] = float(np.mean(stddev))
    if "visibility/distance" in answer:
        message = answer["visibility/distance"]
        estimates["visibility_distance"] = message.range
        estimates["visibility_distance_stddev"] = math.sqrt(message.variance)
    if "visibility/depth" in answer:
        pose = answer["visibility/depth"].pose
        estimates["depth"] = -pose.pose.position.z
        estimates["depth_stddev"] = math.sqrt(pose.covariance[14])
    if "disparity" in answer:
        after = score(read_disparity(answer["disparity"]), frame.disparity)
        estimates["matched_after"], estimates["correct_after"] = after
    matched, correct = score(before, frame.disparity)
    return FrameComparison(
        time=time,
        answered=bool(answer),
        latency=latency,
        true_mean_attenuation=frame.mean_attenuation,
        true_visibility_distance=visibility_distance(
            float(frame.attenuation.min()), AssessmentConfig().contrast),
        true_depth=frame.depth,
        matched_before=matched,
        correct_before=correct,
        **estimates,
    )


def score(disparity: DisparityMap, truth: DisparityMap) -> tuple[float, float]:
    """Return the matched and the correct share of the pixels that have a true disparity."""
    matched = matched_fraction(disparity[np.isfinite(truth)])
    return matched, correct_fraction(disparity, truth, CORRECT)


def summarize(rows: Sequence[FrameComparison]) -> list[tuple[str, str]]:
    """Summary statistics for the terminal: names and values.

    The disparity before and after is compared over the frames that the node
    answered.
    """
    answered = [row for row in rows if row.answered]
    mean, median = statistics.fmean, statistics.median

    def over(values: Sequence[float], form: str, take: Callable[[Sequence[float]], float]) -> str:
        kept = [v for v in values if math.isfinite(v)]
        return form.format(take(kept)) if kept else "not assessed"

    alpha = [abs(r.mean_attenuation - r.true_mean_attenuation) for r in answered]
    depth = [abs(r.depth - r.true_depth) for r in answered]
    assessed = sum(math.isfinite(r.mean_attenuation) for r in answered)
    return [
        ("frames in", str(len(rows))),
        ("frames out", str(len(answered))),
        ("of these assessed", str(assessed)),
        ("mean absolute error of alpha", over(alpha, "{:.3f} 1/m", mean)),
        ("mean absolute error of depth", over(depth, "{:.2f} m", mean)),
        ("matched, before enhancement", over([r.matched_before for r in answered], "{:.3f}", mean)),
        ("matched, after", over([r.matched_after for r in answered], "{:.3f}", mean)),
        ("correct (<= 1 px), before", over([r.correct_before for r in answered], "{:.3f}", mean)),
        ("correct (<= 1 px), after", over([r.correct_after for r in answered], "{:.3f}", mean)),
        (
            "median latency, image to last result",
            over([r.latency for r in answered], "{:.0f} ms", median),
        ),
    ]


def write_csv(path: Path, rows: Sequence[FrameComparison]) -> None:
    """Write a row for each frame; what was not assessed is empty."""
    names = [f.name for f in fields(FrameComparison)]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for row in rows:
            writer.writerow(_cell(getattr(row, name)) for name in names)


def _cell(value: float | bool) -> str:
    if isinstance(value, bool):
        return str(int(value))
    return f"{value:.6g}" if math.isfinite(value) else ""
