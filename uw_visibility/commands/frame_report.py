# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Report of one frame: its estimates as plain values for JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from uw_visibility.status import Status

if TYPE_CHECKING:
    from uw_visibility.pipeline.pipeline import FrameResult


def frame_report(result: FrameResult) -> dict[str, Any]:
    """Return the contents of `report.json`.

    Returns
    -------
    dict
        Numbers, strings, lists and dicts only. What is not assessable is None:
        a channel's place in a list, or the whole list where no channel is.
    """
    visibility = result.visibility
    return {
        "status": str(frame_status(result)),
        "step1": {
            "attenuation": _channels(result.coarse_water.attenuation),
            "ambient_light": _channels(result.coarse_water.ambient_light),
            "support_points": int(result.stereo.support_points),
            "coverage": _number(result.stereo.coverage),
        },
        "step2": {
            "attenuation": _channels(result.water.attenuation),
            "attenuation_stddev": _channels(result.water.attenuation_stddev),
            "ambient_light": _channels(result.water.ambient_light),
            "ambient_light_stddev": _channels(result.water.ambient_light_stddev),
            "iterations": int(result.water.iterations),
            "bins": int(result.water.bins),
        },
        "clear_water_attenuation": _channels(result.clear_water_attenuation),
        "mean_attenuation": _number(visibility.mean_attenuation),
        "mean_attenuation_stddev": _number(visibility.mean_attenuation_stddev),
        "visibility_distance": _number(visibility.distance),
        "visibility_distance_stddev": _number(visibility.distance_stddev),
        "depth": _number(visibility.depth),
        "depth_stddev": _number(visibility.depth_stddev),
        "white": None if result.images.scene_light is None else {
            "scene_light": _channels(result.images.scene_light),
            "from_camera": _number(result.images.balanced),
        },
        "matched_fraction": {
            "original": _number(result.stereo.matched_fraction_original),
            "enhanced": _number(result.stereo.matched_fraction),
        },
        "timing_ms": {stage: round(time, 3) for stage, time in result.timing_ms.items()},
    }


def frame_status(result: FrameResult) -> Status:
    """Return ok, or the first reason why a value of the frame is not assessable."""
    visibility = result.visibility
    statuses = (result.status, visibility.status, visibility.depth_status)
    return next((status for status in statuses if status is not Status.OK), Status.OK)


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _channels(values: ArrayLike) -> list[float | None] | None:
    channels = [_number(float(value)) for value in np.asarray(values, np.float64)]
    return None if all(value is None for value in channels) else channels
