# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the water: estimation, assessment, and filter over frames."""

from __future__ import annotations

from dataclasses import dataclass

from uw_visibility.config.parameters import parameter
from uw_visibility.errors import InputError


@dataclass(frozen=True)
class WaterConfig:
    """Estimation of attenuation and ambient light (eq. 4-7)."""

    veil: str = parameter(
        "free",
        "Veil, what the water adds, and light on the scene: free (each of its own; networks "
        "that were trained on random views infer both and attenuation), or paper (one ambient "
        "light for both, by a fit, for water that is lit as the scene is; more precise where "
        "that holds).",
        choices=("free", "paper"),
    )
    min_range_ratio: float = parameter(
        1.25, "Smallest ratio of the farthest to the nearest range that is assessed.",
        minimum=1.0, maximum=10.0,
    )
    daylight_tolerance: float = parameter(
        0.15, "How far the ambient light's colour is expected from that of daylight below "
        "water of assessment.water_type, as seen by camera.white_reference, as part of each "
        "channel; 10 expects nothing.", minimum=0.01, maximum=10.0,
    )


@dataclass(frozen=True)
class AssessmentConfig:
    """Assessment of visibility and depth (eq. 9-14)."""

    contrast: float = parameter(
        0.05, "Smallest contrast that an observer distinguishes (eq. 11).",
        minimum=1e-3, maximum=0.5,
    )
    water_type: str = parameter(
        "clear",
        "Water above the camera, whose attenuation tells how daylight's colour follows depth: "
        "clear sea water, a Jerlov type, or as estimated from each frame.",
        choices=("clear", "IB", "II", "III", "1C", "3C", "5C", "estimated"),
    )
    max_depth: float = parameter(
        60.0, "Largest depth considered.", unit="m", minimum=1.0, maximum=200.0,
    )


@dataclass(frozen=True)
class TrackingConfig:
    """Kalman filter of the water's state over frames."""

    enabled: bool = parameter(
        True, "Filter the estimates of frames that come with a stamp.",
    )
    turbidity_rate: float = parameter(
        0.02, "How fast attenuation wanders, as part of itself.",
        unit="1/s^0.5", minimum=1e-4, maximum=10.0,
    )
    unseen_rate: float = parameter(
        0.06, "How fast attenuation may change, as part of itself, while frames do not show it; "
        "0.06 is that of a vehicle that sinks by 0.25 m a second into water whose "
        "turbidity doubles in three metres.",
        unit="1/s", minimum=0.0, maximum=10.0,
    )
    light_rate: float = parameter(
        0.05, "How fast the colour of the ambient light wanders, as part of each channel.",
        unit="1/s^0.5", minimum=1e-4, maximum=10.0,
    )
    exposure_change: float = parameter(
        0.5, "How much the exposure, common to all channels, may change from frame to frame; "
        "0 for a fixed one.", minimum=0.0, maximum=10.0,
    )
    common_error: float = parameter(
        0.6, "Part of the variance of a frame's estimate that following frames share, since "
        "they show the same scene: filtering does not lessen it.", minimum=0.0, maximum=0.95,
    )
    gate_probability: float = parameter(
        0.999, "Share of the estimates that pass the gate where all is well (chi squared).",
        minimum=0.5, maximum=0.999999,
    )
    reset_count: int = parameter(
        3, "Estimates in a row beyond the gate the last of which is followed, whether or not "
        "they agree; those before it are rejected. Of two that agree the second is followed.",
        minimum=1, maximum=100,
    )
    timeout: float = parameter(
        5.0, "Time without an estimate after which nothing is known of the state.",
        unit="s", minimum=0.01, maximum=3600.0,
    )


@dataclass(frozen=True)
class SurveyConfig:
    """Observations of frames taken together, where each sees too little spread of range."""

    enabled: bool = parameter(
        True, "Estimate the water over frames while single ones do not show it, as in a survey "
        "at constant altitude.",
    )
    window: float = parameter(
        60.0, "Time over which frames are taken together.", unit="s", minimum=1.0,
        maximum=3600.0,
    )
    min_frames: int = parameter(
        20, "Frames that are needed.", minimum=8, maximum=10000,
    )
    max_frames: int = parameter(
        240, "Frames that are kept; of more, evenly spaced ones.", minimum=16, maximum=10000,
    )

    def __post_init__(self) -> None:
        if self.min_frames > self.max_frames:
            raise InputError(
                f"parameter survey.min_frames is {self.min_frames} and survey.max_frames "
                f"{self.max_frames}: keep at least as many frames as are needed"
            )
