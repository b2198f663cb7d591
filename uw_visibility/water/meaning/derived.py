# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Quantities of the field, derived from an estimate of attenuation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.spectra import CameraResponse, load_response
from uw_visibility.optics.visual_range import (
    BEAM_OVER_SEEN,
    BEAM_OVER_SEEN_DEVIATION,
    BLACK_DISC_DEVIATION,
    SECCHI_DEVIATION,
    black_disc_visibility,
)
from uw_visibility.optics.water_type import (
    KEPT,
    KEPT_DEVIATION,
    TYPES,
    inherent_properties,
    seen_attenuation,
    water_type,
)
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate

GREEN = 1

# How far water of a type is from the type's table, as parts of its attenuation: in all
# channels alike, since particles scatter more or less, and in each, since red depends on
# depth and range. Neighbouring types are 0.3 apart, half of which is a type's own.
AMOUNT_TOLERANCE = 0.15
COLOUR_TOLERANCE = np.array([0.3, 0.07, 0.12])
# Daylight in which the types are taken to be seen, and from how far at most, m.
TYPICAL_DEPTH = 3.0
TYPICAL_RANGE = 3.0
# Chi squared of a type beyond which water is not of it (0.1 %), for 1 to 3 channels.
FARTHEST = (10.8, 13.8, 16.3)
# Least share of the likelihood that a type and its neighbours need for a verdict.
TOLD = 0.9
# How far Kd of water of a type is from its table, as a part: half of the way to the next.
DIFFUSE_TOLERANCE = 0.2
# Largest relative standard deviation.
MAX_RELATIVE_STDDEV = 1.0


class Quantity(NamedTuple):
    """Description of a derived quantity.

    `unit` is that of UDUNITS, `title` is for tables and figures.
    """

    unit: str
    title: str
    definition: str
    caveat: str
    source: str


_BY_TYPE = (
    "Not measured: mean over the Jerlov types that fit the attenuation, weighted with their "
    "likelihood; other water with the same attenuation may have another value."
)
QUANTITIES = {
    "beam_attenuation": Quantity(
        "m-1", "beam attenuation, green",
        "Beam attenuation as seen by the camera's green channel, at its effective wavelength",
        "Light scattered by small angles still reaches a camera: a transmissometer reads "
        f"{BEAM_OVER_SEEN:g} times as much, within a factor of "
        f"{math.exp(BEAM_OVER_SEEN_DEVIATION):.2g} (lab/studies/beam_attenuation.md).",
        "Roser, Dunbabin and Geiger 2014, eq. 4-7"),
    "black_disc_visibility": Quantity(
        "m", "black-disc visibility",
        "Horizontal distance at which a diver loses sight of a black disc, 4.8/c, where c is the "
        f"attenuation of the green channel times {BEAM_OVER_SEEN:g}",
        "A camera sees less than c, see beam attenuation; σ includes the error of this factor, and "
        "10 % for the formula.",
        "Zaneveld and Pegau 2003, doi:10.1364/OE.11.002997"),
    "diffuse_attenuation_490": Quantity(
        "m-1", "Kd(490)",
        "Diffuse attenuation of downward irradiance at 490 nm",
        _BY_TYPE, "Jerlov, Marine Optics, 1976, table XXVII"),
    "secchi_depth": Quantity(
        "m", "Secchi depth",
        "Depth at which a white disk disappears from view from above, "
        "ln(|0.14 - Rrs|/0.013)/(2.5 min Kd)",
        _BY_TYPE, "Lee et al. 2015, doi:10.1016/j.rse.2015.08.002"),
}
"""Derived quantities by name; each also has a standard deviation."""


@dataclass(frozen=True)
class DerivedQuantities:
    """Quantities derived from attenuation; NaN where not assessable. See `QUANTITIES`.

    Attributes
    ----------
    beam_attenuation, beam_attenuation_stddev : float
        β of the green channel, 1/m: c as a camera sees it.
    black_disc_visibility, black_disc_visibility_stddev : float
        m.
    water_type : str
        Nearest Jerlov type; empty without a verdict.
    water_type_likelihood : float
        Its share of the likelihood of all types.
    water_type_status : Status
        Reason for no verdict on the type, or `Status.OK`.
    diffuse_attenuation_490, diffuse_attenuation_490_stddev : float
        1/m.
    secchi_depth, secchi_depth_stddev : float
        m.
    """

    beam_attenuation: float = math.nan
    beam_attenuation_stddev: float = math.nan
    black_disc_visibility: float = math.nan
    black_disc_visibility_stddev: float = math.nan
    water_type: str = ""
    water_type_likelihood: float = math.nan
    water_type_status: Status = Status.OK
    diffuse_attenuation_490: float = math.nan
    diffuse_attenuation_490_stddev: float = math.nan
    secchi_depth: float = math.nan
    secchi_depth_stddev: float = math.nan

    def interval(self, name: str) -> tuple[float, float, float]:
        """Return 16, 50 and 84 % of a quantity, which is uncertain by a factor (log-normal)."""
        value = getattr(self, name)
        spread = getattr(self, f"{name}_stddev") / value
        return value * math.exp(-spread), value, value * math.exp(spread)

    @property
    def black_disc_visibility_low(self) -> float:
        """16 % quantile of the black disc's distance, m."""
        return self.interval("black_disc_visibility")[0]

    @property
    def black_disc_visibility_high(self) -> float:
        """84 % quantile of the black disc's distance, m."""
        return self.interval("black_disc_visibility")[2]


class DerivedModel:
    """Model of the field's quantities, given a pipeline's parameters.

    Raises `InputError` if the camera's spectral response cannot be loaded.
    """

    def __init__(self, config: PipelineConfig) -> None:
        response = load_response(config.camera.response)
        self._types = [water_type(name) for name in TYPES]
        self._attenuation = np.stack([_seen(name, response, KEPT) for name in TYPES])
        # What the scattering that is kept changes in it.
        self._change = self._attenuation - np.stack(
            [_seen(name, response, KEPT + KEPT_DEVIATION) for name in TYPES])

    def derive(self, estimate: WaterEstimate) -> DerivedQuantities:
        """Derive the field's quantities, with standard deviations."""
        covariance = estimate.covariance[0::2, 0::2]
        known = np.isfinite(estimate.attenuation)
        if not known.any():
            return DerivedQuantities(water_type_status=estimate.status)
        beam = float(estimate.attenuation[GREEN])
        stddev = math.sqrt(covariance[GREEN, GREEN])
        disc, disc_stddev = math.nan, math.nan
        if stddev <= MAX_RELATIVE_STDDEV * beam:
            disc = float(black_disc_visibility(BEAM_OVER_SEEN * beam))
            disc_stddev = disc * math.hypot(
                stddev / beam, BEAM_OVER_SEEN_DEVIATION, BLACK_DISC_DEVIATION)
        beams = (beam, stddev, disc, disc_stddev)
        likelihood, nearest = self._likelihood(
            estimate.attenuation[known], covariance[np.ix_(known, known)], known)
        if nearest > FARTHEST[known.sum() - 1]:
            return DerivedQuantities(*beams, water_type_status=Status.NO_WATER_TYPE)
        best = int(likelihood.argmax())
        diffuse = _expected(
            likelihood, [each.diffuse_attenuation_490 for each in self._types], DIFFUSE_TOLERANCE)
        secchi = _expected(
            likelihood, [each.secchi_depth for each in self._types],
            math.hypot(DIFFUSE_TOLERANCE, SECCHI_DEVIATION))
        name, share, status = TYPES[best], float(likelihood[best]), Status.OK
        if likelihood[max(best - 1, 0):best + 2].sum() < TOLD:
            name, share, status = "", math.nan, Status.WATER_TYPE_UNCERTAIN
        return DerivedQuantities(*beams, name, share, status, *diffuse, *secchi)

    def _likelihood(
        self, attenuation: Array, covariance: Array, known: Mask
    ) -> tuple[Array, float]:
        """Share of each type in the likelihood, and chi squared of the nearest one."""
        log_likelihood, distances = [], []
        for expected, change in zip(
                self._attenuation[:, known], self._change[:, known], strict=True):
            spread = AMOUNT_TOLERANCE**2 + np.diag(COLOUR_TOLERANCE[known] ** 2)
            total = covariance + spread * np.outer(expected, expected) + np.outer(change, change)
            error = attenuation - expected
            distance = float(error @ np.linalg.solve(total, error))
            distances.append(distance)
            log_likelihood.append(-0.5 * (distance + np.linalg.slogdet(total)[1]))
        likelihood = np.exp(np.array(log_likelihood) - max(log_likelihood))
        return likelihood / likelihood.sum(), min(distances)


def _seen(name: str, response: CameraResponse, kept: float) -> Array:
    """Attenuation of a type over one attenuation length, or the typical range."""
    absorption, scattering = inherent_properties(name, np.array([530.0]))
    path = min(float(1.0 / (absorption + (1.0 - kept) * scattering)[0]), TYPICAL_RANGE)
    return seen_attenuation(name, response, TYPICAL_DEPTH, path, kept)


def _expected(likelihood: Array, values: list[float], tolerance: float) -> tuple[float, float]:
    """Geometric mean over the types, and its standard deviation; NaN where that is too large."""
    logarithm = np.log(values)
    mean = float(likelihood @ logarithm)
    spread = math.sqrt(float(likelihood @ (logarithm - mean) ** 2) + tolerance**2)
    value = math.exp(mean) if spread <= MAX_RELATIVE_STDDEV else math.nan
    return value, value * spread
