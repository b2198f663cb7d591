# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Measurement of the filter over frames: a frame's estimate, and the parts of its error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uw_visibility.water.assessment import joint_covariance
from uw_visibility.water.estimate import WaterEstimate

# Errors that channels have alike are the model's, the ranges' and the scene's, which frames
# have alike too: of rendered frames 0.98 of their variance, and half of the rest. What is new
# in a frame has along them at most so many times the variance of what channels differ by.
_LARGEST_NEW = 30.0
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
        """Take an estimate.

        Parameters
        ----------
        estimate : WaterEstimate
        common_error : float
            The part of its variance that stays; more of what its channels have alike.
        """
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
        noise = (1.0 - common_error) * _own(covariance, index[index % 2 == 0])
        return cls(seen, value, noise, _root(covariance - noise))


def _root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the symmetric root of a covariance, which changes little when that does."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _own(covariance: NDArray[np.float64], index: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return a covariance but for the largest error of attenuation, what channels have alike.

    Parameters
    ----------
    covariance : (6, 6) float64 ndarray
    index : (N,) int ndarray
        Of attenuation in the channels that were seen.
    """
    if len(index) < 2:
        return covariance
    block = np.ix_(index, index)
    values, vectors = np.linalg.eigh(covariance[block])
    kept = _LARGEST_NEW * values[:-1].mean() / values[-1]
    if kept >= 1.0:
        return covariance
    alike = vectors[:, -1]
    shrink = np.eye(6)
    shrink[block] -= (1.0 - np.sqrt(kept)) * np.outer(alike, alike)
    return np.asarray(shrink @ covariance @ shrink)
