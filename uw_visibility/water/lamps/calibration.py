# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Calibration of lamps' places, axes and beams from ground seen in several frames.

As in `uw_visibility.water.lamps.track_fit`, ratios of a tracked point's light over frames depend on
the lamps. Robust nonlinear least squares of ln (E − s S), with a free mean of each track; weak
priors around the guess determine what the frames do not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from uw_visibility.compute.robust import charbonnier_weight, median_deviation
from uw_visibility.config.lighting import ISOTROPIC, Lamp
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility.optics.lamps import Ways, across, vector
from uw_visibility.water.lamps import track_fit
from uw_visibility.water.lamps.posterior import BEAM_DEVIATION
from uw_visibility.water.lamps.tracks import Sightings

# Sightings that are fitted at most, and at least.
MOST_CELLS, FEWEST_CELLS = 8000, 300
# Least ratio of farthest to nearest range, by quantiles of the sightings.
LEAST_RATIO, RANGE_QUANTILES = 1.4, (0.05, 0.95)
# Largest standard deviation of a place, m.
MOST_STDDEV = 0.2
# Deviations of the priors: of places (m), axes (rad), and the logarithm of one lamp's power over
# another's.
PLACE, AXIS, RATIO = 0.5, math.radians(10.0), 0.1
# Steps of the fit at most, and that of derivatives.
MOST_STEPS, STEP = 100, 1e-4
# Scatter of ln E at the start.
SCATTER = 0.1
# Largest part of the sightings whose own light is limited from below.
MOST_LIMITED = 0.02
# Errors of the model that are not in the scatter, such as shapes of beam and ground and scale of
# range: of places (m), axes (degrees), the beam's angle (relative), and β (1/m).
PLACE_ERROR, AXIS_ERROR, BEAM_ERROR, BETA_ERROR = 0.03, 3.0, 0.12, 0.03


@dataclass(frozen=True)
class LampCalibration:
    """Calibrated lamps, with standard deviations."""

    lamps: tuple[Lamp, ...]
    position_stddev: Array  # (L, 3), m
    direction_stddev: Array  # (L,), larger of an axis' two deviations, degrees
    beam_stddev: float  # of the beams' angles, as a fraction; 0 for lamps without a beam
    attenuation: Array  # (3,), β of the recording's water, 1/m
    attenuation_stddev: Array  # (3,), 1/m
    scatter: float  # standard deviation of ln E about the fit
    range: Array  # (N,), of the sightings, m
    # (N, 3), ln of light over the model's with guessed lamps, minus the mean of each point
    before: Array
    after: Array  # (N, 3), the same with calibrated lamps

    def parameters(self) -> dict[str, object]:
        """Return the lamps as parameters, by dotted name."""
        return {
            "lighting.model": "lamps",
            "lighting.positions": [round(v, 4) for lamp in self.lamps for v in lamp.position],
            "lighting.directions": [round(v, 5) for lamp in self.lamps for v in lamp.direction],
            "lighting.beam_angles": [round(lamp.beam_angle, 2) for lamp in self.lamps],
            "lighting.colours": [round(v, 4) for lamp in self.lamps for v in lamp.colour],
            "lighting.position_stddev": round(_rms(self.position_stddev), 4),
            "lighting.direction_stddev": round(_rms(self.direction_stddev), 2)}


class _Model:
    """Light of sightings for a vector of parameters."""

    def __init__(self, lamps: Sequence[Lamp], cells: Sightings) -> None:
        self.lamps = lamps
        self.cells = cells
        count = len(lamps)
        self.beamed = any(lamp.beam_angle < ISOTROPIC for lamp in lamps)
        sizes = (3 * count, 2 * count, int(self.beamed), count - 1, 1, 3, 3)
        ends = np.cumsum(sizes)
        (self.places, self.tilts, self.beam, self.ratios, self.exponent, self.beta,
         self.scattering) = (slice(b - a, b) for a, b in zip(sizes, ends, strict=True))
        self.mean, self.stddev = np.zeros(ends[-1]), np.full(ends[-1], np.inf)
        for part, mean, stddev in (
            (self.places, np.ravel([lamp.position for lamp in lamps]), PLACE),
            (self.tilts, 0.0, AXIS), (self.beam, 0.0, BEAM_DEVIATION), (self.ratios, 0.0, RATIO),
            (slice(-len(track_fit.START), None), track_fit.START, track_fit.DEVIATION),
        ):
            self.mean[part], self.stddev[part] = mean, stddev

    def found(self, p: Array) -> tuple[Lamp, ...]:
        """The lamps of parameters."""
        factors = np.exp(np.concatenate([[0.0], p[self.ratios]]))
        widened = math.exp(float(p[self.beam][0])) if self.beamed else 1.0
        places, tilts = p[self.places].reshape(-1, 3), p[self.tilts].reshape(-1, 2)
        out = []
        for lamp, place, tilt, factor in zip(self.lamps, places, tilts, factors, strict=True):
            axis = np.array(lamp.direction)
            right, down = across(axis)
            axis = axis + tilt[0] * right + tilt[1] * down
            angle = lamp.beam_angle
            out.append(Lamp(
                vector(place), vector(axis / np.linalg.norm(axis)),
                angle if angle >= ISOTROPIC else min(angle * widened, 350.0),
                vector(factor * np.array(lamp.colour))))
        return tuple(out)

    def residuals(self, p: Array) -> Array:
        """ln (E − s S) − ln D less its mean over each track, (N, 3)."""
        direct, own = self.parted(p)
        every = np.full(own.shape, True)
        return track_fit.less_means(np.log(own / direct), self.cells.track, every)

    def parted(self, p: Array) -> tuple[Array, Array]:
        """D, and E − s S, which is limited from below, each (N, 3)."""
        cells, light, beta, lamps = (
            self.cells, self.cells.light, np.exp(p[self.beta]), self.found(p))
        direct, _, _ = Ways.by_ground(cells.direction, cells.range, cells.normal, lamps).sum(
            beta, p[self.exponent][0])
        scattered, _, _ = Ways.by_water(cells.direction, cells.range, lamps).sum(beta)
        s = track_fit.scattering_factor(light, direct, p[self.beta], p[self.scattering])
        return direct, np.maximum(light - s * scattered, track_fit.OWN_PART * light)


def calibrate_lamps(
    frames: Sequence[Sightings], guesses: Sequence[Sequence[Lamp]]
) -> LampCalibration:
    """Fit places, axes and beams of lamps to points seen at many ranges, in the order of time.

    `guesses` are rigs to start from, of which the one that fits best is taken. Raises `InputError`
    if there are too few sightings, ranges are too alike, or places stay uncertain.
    """
    cells, group = track_fit.pool_tracks(frames, MOST_CELLS)
    total = len(cells.range)
    if total < FEWEST_CELLS:
        raise InputError(
            f"lamps cannot be calibrated: points of the ground are seen {total} times by frames "
            f"that follow one another, {FEWEST_CELLS} are needed: record well lit ground, slowly")
    low, high = np.quantile(cells.range, RANGE_QUANTILES)
    if high < LEAST_RATIO * low:
        raise InputError(
            f"the ranges differ too little to find lamps, {low:.2f} to {high:.2f} m: record "
            f"ground from distances that differ {LEAST_RATIO:g} times or more, sinking and rising")
    tried = []
    for guess in guesses:
        model = _Model(guess, cells)
        # A prior of more weight first avoids places that fit by chance.
        tried.append((*_fit(model, model.mean, SCATTER, 10, 3 * track_fit.TOGETHER), model))
    _, start, model = min(tried, key=lambda each: each[0])
    scatter = median_deviation(model.residuals(start))
    _, p = _fit(model, start, scatter, MOST_STEPS)
    halves = []
    for part in (0, 1):
        every_second = cells.where(cells.track % 2 == part)
        half = replace(every_second, track=every_second.track // 2)
        halves.append(_fit(_Model(model.lamps, half), start, scatter, MOST_STEPS)[1][model.places])
    return _assembled(model, p, scatter, group, _rms(halves[1] - halves[0]) / 2)


def _fit(
    model: _Model, start: Array, scatter: float, steps: int, together: float = track_fit.TOGETHER
) -> tuple[float, Array]:
    """Cost and parameters of the robust fit."""

    def residuals(p: Array) -> Array:
        # The loss is robust for the sightings, quadratic for the prior.
        seen = model.residuals(p).ravel() / scatter
        root = np.sign(seen) * np.sqrt(2.0 * (np.sqrt(1.0 + seen**2) - 1.0))
        return np.concatenate([root / together, (p - model.mean) / model.stddev])

    found = least_squares(
        residuals, start, x_scale=np.minimum(model.stddev, 1.0), max_nfev=steps,
        ftol=1e-6, xtol=1e-6)
    if steps >= MOST_STEPS and found.status == 0:
        raise InputError(
            "the fit of the lamps does not converge: give better places with --params-file, or a "
            "recording of even ground from more distances")
    return float(found.cost), np.asarray(found.x)


def _assembled(
    model: _Model, p: Array, scatter: float, group: NDArray[np.int64], spread: float
) -> LampCalibration:
    limited = (model.parted(p)[1] <= 1.001 * track_fit.OWN_PART * model.cells.light).mean()
    if limited > MOST_LIMITED:
        raise InputError(
            f"the water in front of {100 * limited:.0f} % of the points outshines them, so that "
            "lamps cannot be found: record in clearer water, from nearer")
    residual = model.residuals(p) / scatter
    # By central differences.
    jacobian = np.stack([
        (model.residuals(p + STEP * unit) - model.residuals(p - STEP * unit)) / (2 * STEP * scatter)
        for unit in np.eye(len(p))], axis=2)
    # Score and curvature of the weighted loss.
    bread, covariance = _sandwich(
        jacobian, charbonnier_weight(residual) / track_fit.TOGETHER**2, residual, group,
        1.0 / model.stddev**2)
    covariance = np.maximum(np.diag(covariance), np.diag(bread))
    deviation = np.sqrt(covariance)
    places = np.hypot(deviation[model.places], math.hypot(spread, PLACE_ERROR)).reshape(-1, 3)
    axes = np.degrees(deviation[model.tilts].reshape(-1, 2).max(axis=1))
    if not places.max() <= MOST_STDDEV:
        raise InputError(
            f"places of lamps stay uncertain by {places.max():.2f} m, more than "
            f"{MOST_STDDEV:g} m: record even ground from more distances, and from nearer")
    beta = np.exp(p[model.beta])
    return LampCalibration(
        model.found(p), places, np.hypot(axes, AXIS_ERROR),
        math.hypot(deviation[model.beam][0], BEAM_ERROR) if model.beamed else 0.0, beta,
        np.hypot(beta * deviation[model.beta], BETA_ERROR), scatter, model.cells.range,
        model.residuals(model.mean), residual * scatter)


def _sandwich(
    jacobian: Array, weight: Array, residual: Array, group: NDArray[np.int64], prior: Array
) -> tuple[Array, Array]:
    """Inverse curvature and covariance of a weighted fit whose errors are alike within groups.

    Jacobian (N, 3, P), weights and residuals (N, 3), groups (N,) and the precision beforehand,
    (P,); neighbouring sightings and the channels share errors of range and ground. Returns (P, P)
    each (Huber 1967).
    """
    curvature = np.einsum("nci,nc,ncj->ij", jacobian, weight, jacobian, optimize=True)
    bread = np.linalg.inv(curvature + np.diag(prior))
    summed = np.zeros((int(group.max()) + 1, len(prior)))
    np.add.at(summed, group, np.einsum("nci,nc->ni", jacobian, weight * residual))
    return bread, bread @ (summed.T @ summed + np.diag(prior)) @ bread


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
