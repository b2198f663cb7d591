# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Table I of the paper: computation times of the steps, ours beside the paper's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

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
