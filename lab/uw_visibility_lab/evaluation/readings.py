# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimated and true state of the water, in one form for tables and figures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import Array, DisparityMap, Image8, RangeMap
from uw_visibility.optics.light_model import ambient_light_at_depth, visibility_distance
from uw_visibility.pipeline.parts import WaterResult, estimate_water
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Assessor, Visibility
from uw_visibility.water.series.filter import FilteredWater
from uw_visibility_lab.evaluation.fits import fit_plain

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Truth:
    """True state of the water."""

    mean_attenuation: float  # α, 1/m
    depth: float  # z, m, positive down
    attenuation: Triple  # attenuation, ambient_light: β, 1/m, and I∞ for R, G, B
    ambient_light: Triple
    distance: float  # visibility distance (eq. 12), m

    @classmethod
    def of_water(
        cls, attenuation: ArrayLike, ambient_light: ArrayLike, clear_water_attenuation: ArrayLike,
        depth: float, contrast: float,
    ) -> Truth:
        """Derive everything from β, I∞ and κ, with the visible contrast of eq. 11."""
        beta = np.asarray(attenuation, dtype=np.float64)
        return cls(
            float(np.mean(beta - np.asarray(clear_water_attenuation))), depth, triple(beta),
            triple(ambient_light), visibility_distance(float(beta.min()), contrast))

    @classmethod
    def of_clear_water_and_particles(
        cls, mean_attenuation: float, depth: float, clear_water_attenuation: Array, contrast: float,
    ) -> Truth:
        """Water as `degrade` makes it: β = κ + α, and T·I0 = 1 (eq. 2 and 3)."""
        beta = clear_water_attenuation + mean_attenuation
        ambient = ambient_light_at_depth(beta, depth)
        return cls.of_water(beta, ambient, clear_water_attenuation, depth, contrast)


@dataclass(frozen=True)
class Reading:
    """Estimated state of the water with σ; NaN = not assessable."""

    # status, distance_status, depth_status: ``ok``, or the reason why the water, the visibility
    # distance or the depth is not assessable
    status: str
    distance_status: str
    depth_status: str
    attenuation: Triple  # attenuation, attenuation_stddev: β for R, G, B, 1/m
    attenuation_stddev: Triple
    ambient_light: Triple  # ambient_light, ambient_light_stddev: I∞ for R, G, B
    ambient_light_stddev: Triple
    mean_attenuation: float  # mean_attenuation, mean_attenuation_stddev: α, 1/m
    mean_attenuation_stddev: float
    distance: float  # distance, distance_stddev: visibility distance, m
    distance_stddev: float
    depth: float  # depth, depth_stddev: m, positive down
    depth_stddev: float

    @classmethod
    def of(cls, estimate: WaterEstimate, visibility: Visibility) -> Reading:
        """Reading of an estimate and its assessment."""
        return cls(
            str(estimate.status), str(visibility.status), str(visibility.depth_status),
            triple(estimate.attenuation), triple(estimate.attenuation_stddev),
            triple(estimate.ambient_light), triple(estimate.ambient_light_stddev),
            visibility.mean_attenuation, visibility.mean_attenuation_stddev,
            visibility.distance, visibility.distance_stddev,
            visibility.depth, visibility.depth_stddev,
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
    """Reader of estimates of the water, and of the paper's own."""

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self.assessor = Assessor(config)

    def read(self, estimate: WaterEstimate) -> Reading:
        """Return an estimate with its assessment."""
        return Reading.of(estimate, self.assessor.assess(estimate))

    def fit_plain(self, image: Image8, ranges: RangeMap) -> Reading:
        """Fit the water as the paper does, by ranges in m."""
        return self.read(fit_plain(
            image, ranges, self.assessor.clear_water_attenuation, self._config.camera.transfer))


reader_of = lru_cache(maxsize=8)(Reader)


def read_exact(
    image: Image8, disparity: DisparityMap, rig: StereoRig, config: PipelineConfig
) -> Reading:
    """Estimate the water from an image and its true disparities, px."""
    return Reading.of_result(
        estimate_water(image, disparity, rig, config, disparity_stddev=0.0))


def triple(values: ArrayLike) -> Triple:
    """Return the values for R, G, B as plain numbers."""
    red, green, blue = (float(v) for v in np.asarray(values, dtype=np.float64))
    return red, green, blue
