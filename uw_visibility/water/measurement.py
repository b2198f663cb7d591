# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Measurement of the filter over frames: a frame's estimate, and the parts of its error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uw_visibility.water.assessment import joint_covariance
from uw_visibility.water.estimate import WaterEstimate

ATTENUATION = slice(0, 6, 2)
LIGHT = slice(1, 6, 2)


@dataclass(frozen=True)
class Measurement:
    """A frame's estimate: β and ln I∞ of each channel, and the two parts of its error.

    Attributes
    ----------
    seen : (3,) bool ndarray
        Channels that were assessed.
    value : (6,) float64 ndarray
    noise : (6, 6) float64 ndarray
        Covariance of what is new in each frame.
    common : (6, 6) float64 ndarray
        Root of the covariance of what stays the same.
    """

    seen: NDArray[np.bool_]
    value: NDArray[np.float64]
    noise: NDArray[np.float64]
    common: NDArray[np.float64]

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(6, 6) float64: of both parts of the error."""
        return np.asarray(self.noise + self.common @ self.common.T)

    @classmethod
    def of(cls, estimate: WaterEstimate, common_error: float) -> Measurement:
        """Take an estimate; ``common_error`` is the part of its variance that stays."""
        joint = joint_covariance(estimate)
        seen = np.isfinite(estimate.attenuation) & np.isfinite(estimate.ambient_light)
        seen &= np.isfinite(np.diag(joint)).reshape(3, 2).all(axis=1)
        index = np.flatnonzero(np.repeat(seen, 2))
        value = np.zeros(6)
        value[ATTENUATION] = np.where(seen, estimate.attenuation, 0.0)
        light = np.where(seen, estimate.ambient_light, 1.0)
        value[LIGHT] = np.log(light)
        scale = np.ones(6)
        scale[LIGHT] = 1.0 / light
        covariance = np.zeros((6, 6))
        covariance[np.ix_(index, index)] = (np.outer(scale, scale) * joint)[np.ix_(index, index)]
        return cls(
            seen, value, (1.0 - common_error) * covariance, _root(common_error * covariance)
        )


def _root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the symmetric root of a covariance, which changes little when that does."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
