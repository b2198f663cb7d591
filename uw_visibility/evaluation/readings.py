# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimated and true state of the water, in one form for tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, DisparityMap, Image8, Map, RangeMap
from uw_visibility.optics.light_model import ambient_light_at_depth, visibility_distance
from uw_visibility.pipeline.parts import WaterResult
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.assessment import Assessor, Visibility
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.estimation import WaterEstimator
from uw_visibility.water.filter import FilteredWater

CHANNELS = ("red", "green", "blue")
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Truth:
    """True state of the water.

    Attributes
    ----------
    mean_attenuation : float
        α, 1/m.
    depth : float
        z, m, positive down.
    attenuation, ambient_light : tuple of float
        β, 1/m, and I∞ for R, G, B.
    distance : float
        Visibility distance (eq. 12), m.
    """

    mean_attenuation: float
    depth: float
    attenuation: Triple
    ambient_light: Triple
    distance: float

    @classmethod
    def of_water(
        cls,
        attenuation: ArrayLike,
        ambient_light: ArrayLike,
        clear_water_attenuation: ArrayLike,
        depth: float,
        contrast: float,
    ) -> Truth:
        """Derive everything from β, I∞ and κ, with the visible contrast of eq. 11."""
        beta = np.asarray(attenuation, dtype=np.float64)
        return cls(
            mean_attenuation=float(np.mean(beta - np.asarray(clear_water_attenuation))),
            depth=depth,
            attenuation=triple(beta),
            ambient_light=triple(ambient_light),
            distance=visibility_distance(float(beta.min()), contrast),
        )

    @classmethod
    def of_clear_water_and_particles(
        cls,
        mean_attenuation: float,
        depth: float,
        clear_water_attenuation: Array,
        contrast: float,
    ) -> Truth:
        """Water as `degrade` makes it: β = κ + α, and T·I0 = 1 (eq. 2 and 3)."""
        beta = clear_water_attenuation + mean_attenuation
        ambient = ambient_light_at_depth(beta, depth)
        return cls.of_water(beta, ambient, clear_water_attenuation, depth, contrast)


@dataclass(frozen=True)
class Reading:
    """Estimated state of the water with σ; NaN = not assessable.

    Attributes
    ----------
    status, distance_status, depth_status : str
        ``ok``, or the reason why the water, the visibility distance or the depth is
        not assessable.
    attenuation, attenuation_stddev : tuple of float
        β for R, G, B, 1/m.
    ambient_light, ambient_light_stddev : tuple of float
        I∞ for R, G, B.
    mean_attenuation, mean_attenuation_stddev : float
        α, 1/m.
    distance, distance_stddev : float
        Visibility distance, m.
    depth, depth_stddev : float
        m, positive down.
    """

    status: str
    distance_status: str
    depth_status: str
    attenuation: Triple
    attenuation_stddev: Triple
    ambient_light: Triple
    ambient_light_stddev: Triple
    mean_attenuation: float
    mean_attenuation_stddev: float
    distance: float
    distance_stddev: float
    depth: float
    depth_stddev: float

    @classmethod
    def of(cls, estimate: WaterEstimate, visibility: Visibility) -> Reading:
        """Reading of an estimate and its assessment."""
        return cls(
            status=str(estimate.status),
            distance_status=str(visibility.status),
            depth_status=str(visibility.depth_status),
            attenuation=triple(estimate.attenuation),
            attenuation_stddev=triple(estimate.attenuation_stddev),
            ambient_light=triple(estimate.ambient_light),
            ambient_light_stddev=triple(estimate.ambient_light_stddev),
            mean_attenuation=visibility.mean_attenuation,
            mean_attenuation_stddev=visibility.mean_attenuation_stddev,
            distance=visibility.distance,
            distance_stddev=visibility.distance_stddev,
            depth=visibility.depth,
            depth_stddev=visibility.depth_stddev,
        )

    @classmethod
    def of_result(cls, result: FrameResult | WaterResult | FilteredWater) -> Reading:
        """Reading of a result's water and visibility."""
        return cls.of(result.water, result.visibility)

    @classmethod
    def refused(cls, reason: str) -> Reading:
        """Reading in which nothing was assessed, with the reason."""
        visibility = Visibility(Status.NO_TEXTURE, Status.NO_TEXTURE)
        reading = cls.of(WaterEstimate.not_assessable(Status.NO_TEXTURE), visibility)
        statuses = dict.fromkeys(("status", "distance_status", "depth_status"), reason)
        return cls(**{**vars(reading), **statuses})


class Reader:
    """Reader of estimates of the water, and of what a method makes of an image and its ranges.

    Parameters
    ----------
    config : PipelineConfig
        How the water is estimated and assessed.

    Attributes
    ----------
    assessor : Assessor
    """

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self.assessor = Assessor.from_config(config)

    def read(self, estimate: WaterEstimate) -> Reading:
        """Return an estimate with its assessment."""
        return Reading.of(estimate, self.assessor.assess(estimate))

    def estimate(self, image: Image8, ranges: RangeMap, method: str | None = None) -> Reading:
        """Estimate the water from an image and ranges, m, each of which is taken as exact.

        `method` is that of the configuration where absent, see `WaterConfig`.
        """
        config = self._config
        water = config.water if method is None else replace(config.water, method=method)
        estimator = WaterEstimator(
            water, self.assessor.clear_water_attenuation, config.camera.transfer,
            self.assessor.daylight,
        )
        return self.read(estimator.estimate(image, ranges, range_error=0.0))


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested values as one row of a table, by dotted names; records by their fields.

    Tuples are of the channels.
    """
    row: dict[str, Any] = {}
    for name, value in values.items():
        inside = vars(value) if isinstance(value, (Truth, Reading)) else value
        if isinstance(value, tuple):
            inside = dict(zip(CHANNELS, value, strict=True))
        if isinstance(inside, Mapping):
            row |= flat(inside, f"{prefix}{name}.")
        else:
            row[f"{prefix}{name}"] = value
    return row


def match_and_read(
    left: Image8, right: Image8, rig: StereoRig,
    disparity: DisparityMap, config: PipelineConfig,
) -> tuple[Reading, Map | None]:
    """Let the pipeline match a pair, as far as the true disparities (px) go.

    Returns the reading, and what was matched, px; None for a pair that is refused.
    """
    largest = int(np.nanmax(disparity)) + 8
    config = replace(config, stereo=replace(config.stereo, max_disparity=largest))
    try:
        result = Pipeline(rig, config).process(left, right)
    except InputError as error:
        return Reading.refused(f"pair refused: {error}"), None
    return Reading.of_result(result), result.disparity


def triple(values: ArrayLike) -> Triple:
    """Return the values for R, G, B as plain numbers."""
    red, green, blue = (float(v) for v in np.asarray(values, dtype=np.float64))
    return red, green, blue
