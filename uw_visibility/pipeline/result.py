# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the pipeline tells of one stereo pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.status import Status
from uw_visibility.water.assessment import Visibility
from uw_visibility.water.estimation import WaterEstimate
from uw_visibility.water.tracking import TrackingEvent


@dataclass(frozen=True)
class FrameResult:
    """Everything that one stereo pair tells.

    Arrays are not written to after construction. A quantity that could not be
    assessed is NaN, and the status beside it says why.

    Attributes
    ----------
    status : Status
        Whether the water could be assessed (that of `water`).
    step1, water : WaterEstimate
        Attenuation and ambient light after the first and after the second step.
    visibility : Visibility
        Mean attenuation, visibility distance and depth with standard deviations.
    clear_water_attenuation : ndarray
        ``(3,)`` float64, 1/m, RGB.
    disparity : ndarray
        ``(H, W)`` float32, left-referenced, px; NaN where unmatched.
    disparity_filled : ndarray
        ``(H, W)`` float32, px; gaps filled, for colour only. Finite where
        anything matched at all, else NaN everywhere, as where no image was
        wanted enhanced.
    range : ndarray
        ``(H, W)`` float32, m, of `disparity_filled`, along the line of sight;
        infinite where the filled disparity lies at or beyond infinity.
    disparity_original : ndarray or None
        ``(H, W)`` float32, px; the raw pair matched alone, where asked for.
    left_enhanced, right_enhanced : ndarray
        Like the input images; empty where not wanted.
    limited : ndarray
        ``(H, W)`` bool; pixels of the left image whose gain was limited;
        empty where that image was not wanted.
    support_points : int
        Support points of step 1.
    coverage : float
        Part of the left image that their mesh covers.
    matched_fraction_original : float or None
        Matched part of `disparity_original`.
    matched_fraction_enhanced : float
        Matched part of `disparity`.
    min_disparity, max_disparity : int
        Limits of the search, inclusive, px.
    timing_ms : dict of str to float
        Duration of each stage and of the whole (``total``); two stages may overlap.
    right_gain : ndarray or None
        ``(3,)``, or ``(1,)`` for grey images: irradiance in the right image over
        that in the left one. The right image's ambient light is that of `water`
        times this.
    tracked : WaterEstimate or None
        The water's state filtered over frames; None where the frame had no
        stamp, or tracking is off. `water` and `visibility` are of this frame
        alone.
    tracked_visibility : Visibility or None
        Of `tracked`.
    tracking : TrackingEvent or None
        What this frame did to the filtered state.
    confidence : ndarray or None
        ``(H, W)`` float32, probability that `disparity` is within 1 px of the truth;
        0 where unmatched; None where not asked for.
    """

    status: Status
    step1: WaterEstimate
    water: WaterEstimate
    visibility: Visibility
    clear_water_attenuation: NDArray[np.float64]
    disparity: NDArray[np.float32]
    disparity_filled: NDArray[np.float32]
    range: NDArray[np.float32]
    disparity_original: NDArray[np.float32] | None
    left_enhanced: NDArray[Any]
    right_enhanced: NDArray[Any]
    limited: NDArray[np.bool_]
    support_points: int
    coverage: float
    matched_fraction_original: float | None
    matched_fraction_enhanced: float
    min_disparity: int
    max_disparity: int
    timing_ms: dict[str, float]
    right_gain: NDArray[np.float64] | None = None
    tracked: WaterEstimate | None = None
    tracked_visibility: Visibility | None = None
    tracking: TrackingEvent | None = None
    confidence: NDArray[np.float32] | None = None
