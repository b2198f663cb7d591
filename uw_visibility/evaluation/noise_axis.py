# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Noise of the sensor as an axis of the experiments."""

from __future__ import annotations

from uw_visibility.errors import InputError
from uw_visibility.simulation.camera import Sensor

CAMERA = "camera"
"""Name of the shot and read noise of a small camera, that of `Sensor`."""

def sensor_of(noise: str) -> Sensor:
    """Return the sensor of a noise.

    Parameters
    ----------
    noise : str
        Standard deviation of Gaussian noise in codes of 255, or ``camera``.

    Raises
    ------
    InputError
        If it is neither.
    """
    if noise == CAMERA:
        return Sensor()
    try:
        codes = float(noise)
    except ValueError:
        raise InputError(
            f"noise is {noise!r}: give codes of 255, such as 2, or {CAMERA} for shot and read noise"
        ) from None
    return Sensor.gaussian(codes)


def title_of(noise: str) -> str:
    """Return how tables and figures name a noise."""
    if noise == CAMERA:
        return "shot and read noise"
    return "no noise" if noise == "0" else f"noise of {noise} codes"
