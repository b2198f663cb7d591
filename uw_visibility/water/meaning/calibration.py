# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Calibration of white reference and water type against a depth sensor.

The ratio of two channels' ambient light is that of white at the surface times
exp(−(K₁ − K₂) z): in logarithms a line over depth, whose slope belongs to the
water and whose offset to the camera's white.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uw_visibility.compute.robust import huber_mean, median_deviation
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility.optics.spectra import CameraResponse
from uw_visibility.optics.water_type import water_types
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import covariance_with_light
from uw_visibility.water.meaning.depth import CLEAR, ESTIMATED, DepthModel, diffuse_attenuation

FEWEST_FRAMES = 10


@dataclass(frozen=True)
class Candidate:
    """Candidate water type with the white reference that fits it best."""

    water_type: str  # as in `assessment.water_type`
    white_reference: Array  # (3,), R, G, B of white at the surface; G is 1
    white_reference_stddev: Array  # (3,)
    depth_rms: float  # robust root mean square of estimated minus sensed depth, m


@dataclass(frozen=True)
class Calibration:
    """Result of `calibrate`."""

    best: Candidate  # clear water unless another type is certainly better
    candidates: tuple[Candidate, ...]  # all, by rising `depth_rms`
    residuals: Array  # (N,), estimated minus sensed depth of each frame used, with `best`, m
    # least and largest depth sensed, m; a narrow range hardly tells the water type
    depth_range: tuple[float, float]

    def parameters(self) -> dict[str, str | tuple[float, ...]]:
        """Return the parameters found, by their dotted names."""
        white = tuple(round(float(value), 4) for value in self.best.white_reference)
        return {"camera.white_reference": white, "assessment.water_type": self.best.water_type}


def calibrate(
    estimates: Sequence[WaterEstimate], depths: ArrayLike, response: CameraResponse
) -> Calibration:
    """Fit the white reference, and choose the water type that fits the depths best.

    `estimates` are one a frame, in the order of time; those without an estimate of all channels, as
    in depths without red light, are left out. `depths` (N,) are the camera's by a sensor, m,
    positive down; NaN where there is none. Raises `InputError` if fewer than ten frames can be
    used.
    """
    sensed = np.asarray(depths, dtype=np.float64)
    used = [
        k for k, estimate in enumerate(estimates)
        if np.isfinite(estimate.attenuation).all() and math.isfinite(sensed[k])]
    if len(used) < FEWEST_FRAMES:
        raise InputError(
            f"{len(used)} of {len(estimates)} frames have a depth and an estimate of all channels: "
            f"a calibration needs {FEWEST_FRAMES} at least")
    chosen, sensed = [estimates[k] for k in used], sensed[used]
    fits = [_fit(name, chosen, sensed, response) for name in (CLEAR, *water_types(), ESTIMATED)]
    ordered = sorted(fits, key=lambda fit: fit[0].depth_rms)
    # The deviation of a root mean square over n independent values is its 1/sqrt(2n).
    count = _independent(ordered[0][1])
    tolerable = ordered[0][0].depth_rms * (1.0 + 2.0 / math.sqrt(2.0 * count))
    best = fits[0] if fits[0][0].depth_rms <= tolerable else ordered[0]
    return Calibration(
        best=best[0],
        candidates=tuple(candidate for candidate, _ in ordered),
        residuals=best[1],
        depth_range=(float(sensed.min()), float(sensed.max())))


def _fit(
    water_type: str, estimates: list[WaterEstimate], sensed: Array, response: CameraResponse
) -> tuple[Candidate, Array]:
    """Fit the white reference for a water type; return the residuals of depth with it."""
    # The veil has another colour than the light on the scene, which depth is told by.
    light = np.log([estimate.scene_light for estimate in estimates])
    if water_type == ESTIMATED:
        rate = np.array([estimate.attenuation for estimate in estimates])
    else:
        rate = np.tile(diffuse_attenuation(water_type, response), (len(estimates), 1))
    # What is left of each frame once the water above is taken off: white, if all is right.
    white = light + rate * sensed[:, np.newaxis]
    white = white - white[:, 1:2]
    mean, spread = np.zeros(3), np.zeros(3)
    for c in (0, 2):
        mean[c], scale = huber_mean(white[:, c])
        spread[c] = scale / math.sqrt(_independent(white[:, c] - mean[c]))
    reference = np.exp(mean)
    model = DepthModel(water_type, response, reference)
    depths = np.array([
        model.depth(e.attenuation, e.scene_light, covariance_with_light(e))[0] for e in estimates])
    residuals = depths - sensed
    most = 3.0 * max(median_deviation(residuals), 1e-9)
    rms = float(np.sqrt(np.mean(np.clip(residuals, -most, most) ** 2)))
    return Candidate(water_type, reference, reference * spread, rms), residuals


def _independent(residuals: Array) -> float:
    """Effective sample size of a series in time (first-order autoregression)."""
    centred = residuals - residuals.mean()
    variance = float(centred @ centred)
    if variance == 0:
        return float(len(centred))
    correlation = min(max(float(centred[1:] @ centred[:-1]) / variance, 0.0), 0.98)
    return max(len(centred) * (1.0 - correlation) / (1.0 + correlation), 1.0)
