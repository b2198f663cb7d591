# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Attenuation from ground points seen at several ranges, by known lamps.

A tracked point keeps its reflectance ρ, so that the ratios of its light

    E − s S = P ρ Σ cosᵏ(i) g(θ) e^(−β(r + d)) / r²

over the frames show β, whatever the ground is. D and S as in `uw_visibility.optics.lamps`; the
exponent k of the incidence i lies between rough ground (0) and Lambert's (1) (Minnaert 1941,
doi:10.1086/144279), and s near π times the share of scattering in β. Robust least squares (Gauss-
Newton, Charbonnier's loss) of ln (E − s S), with a free mean of each track.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.robust import charbonnier_weight, median_deviation
from uw_visibility.config.lighting import Lamp, LightingConfig
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.lamps import Ways, across
from uw_visibility.water.lamps.posterior import (
    ALBEDO,
    EXPONENT_DEVIATION,
    PARTICLES_DEVIATION,
    REFLECTANCE,
    USUAL_EXPONENT,
    course_of_scattered,
    rigs_in_error,
)
from uw_visibility.water.lamps.tracks import TILES, Sightings

# Largest and least number of sightings, and least number of frames that show a point.
MOST_SIGHTINGS, FEWEST_SIGHTINGS, LEAST_FRAMES = 3000, 150, 3
# Deviation of the prior of the logarithm of s.
SCATTERING = 0.7
# Median of the logarithm of attenuation, 1/m.
USUAL_ATTENUATION = math.log(0.3)
# Least part of the light that is the ground's own, and that of sightings that count: scattered
# light has no information on the ground behind it.
OWN_PART, CLEAR_PART = 0.2, 0.5
# Least scatter of ln E in the fit, and largest one of an estimate: beyond it, power or exposure has
# changed, or lamps are elsewhere.
LEAST_SCATTER, MOST_SCATTER = 0.01, 0.2
# Number of sightings and channels that share an error, as a root.
TOGETHER = 6.0
# Groups of frames; errors in different groups and tiles are taken as independent.
FRAME_GROUPS = 6
# Deviation of the inverse range of a patch of ground over that of a single match. Matches err
# together over a patch: 0.24 over rendered ground, where a match is off by less than is stated.
PLANE_ERROR = 1 / 3
ITERATIONS = 30


@dataclass(frozen=True)
class TrackFit:
    """ln β (3,), β in 1/m, from tracked points, and its covariance (3, 3)."""

    log_attenuation: Array
    covariance: Array


def fit_tracks(
    frames: Sequence[Sightings], lighting: LightingConfig, range_error: float
) -> TrackFit | None:
    """Fit attenuation to points in frames in the order of time, under lamps without daylight.

    `range_error` is the standard deviation of a match's inverse range, 1/m. None with too few
    points, or if they do not fit the lamps.
    """
    if len(frames) < LEAST_FRAMES:
        return None
    cells, _ = pool_tracks(frames, MOST_SIGHTINGS)
    if len(cells.range) < FEWEST_SIGHTINGS:
        return None
    lamps = list(lighting.lamps())
    p, ways = START, _ways(cells, lamps)
    for _ in range(ITERATIONS):
        ratio, change, clear = _compared(cells, ways, p)
        if clear.sum() < 3 * FEWEST_SIGHTINGS:
            return None
        residual, jacobian = (less_means(each, cells.track, clear) for each in (ratio, change))
        scatter = max(median_deviation(residual[clear]), LEAST_SCATTER)
        weight = charbonnier_weight(residual / scatter) / (scatter * TOGETHER) ** 2
        curvature = np.diag(_PRIOR) + np.einsum(
            "nci,nc,ncj->ij", jacobian, weight, jacobian, optimize=True)
        slope = -_slope(jacobian, weight, residual)
        step = np.clip(np.linalg.solve(curvature, slope - _PRIOR * (p - START)), -0.5, 0.5)
        p = p + step
        if np.abs(step).max() < 1e-3:
            break
    if scatter > MOST_SCATTER:
        return None
    # The last step moved p.
    ratio, change, _ = _compared(cells, ways, p, clear)
    # Errors that all sightings share, of lamps and of scattered light.
    beta = np.exp(p[_BETA])
    direct, _, _ = ways[0].sum(beta, p[0])
    errors = [
        np.log(_ways_by_patches(cells, rig).sum(beta, p[0])[0] / direct)
        for rig in rigs_in_error(lighting)]
    share = np.einsum("ncc->nc", change[..., _SCATTERING])
    errors += [share * each[:, np.newaxis] for each in course_of_scattered(
        cells.range, cells.direction).T]
    slopes = [
        _slope(jacobian, weight, less_means(error, cells.track, clear)) for error in errors]
    # Errors of single sightings add up: ranges and normals that are noisy seem to
    # vary more than they do, so that light seems to fall less with them (Fuller 1987,
    # doi:10.1002/9780470316665).
    bias = np.zeros(len(p))
    for other in _in_error(cells, PLANE_ERROR * range_error):
        its_ratio, its_change, _ = _compared(other, _ways(other, lamps), p, clear)
        bias += _slope(its_change - change, weight * clear, its_ratio - ratio)
    covariance = np.linalg.inv(curvature)
    shifts = np.array([*slopes, bias]) @ covariance
    return TrackFit(p[_BETA], (covariance + shifts.T @ shifts)[_BETA, _BETA])


# Parameters: exponent of the cosine, logarithms of β, logarithms of s over its usual value; what
# they are beforehand, and its deviation.
_BETA, _SCATTERING = slice(1, 4), slice(4, 7)
START = np.array([USUAL_EXPONENT, *[USUAL_ATTENUATION] * 3, 0.0, 0.0, 0.0])
DEVIATION = np.array([EXPONENT_DEVIATION, *[PARTICLES_DEVIATION] * 3, *[SCATTERING] * 3])
_PRIOR = 1.0 / DEVIATION**2


def _ways(cells: Sightings, lamps: Sequence[Lamp]) -> tuple[Ways, Ways]:
    """Ways of light by the patches of ground, and by the water before them."""
    return (
        _ways_by_patches(cells, lamps), Ways.by_water(cells.direction, cells.range, lamps))


def _compared(
    cells: Sightings, ways: tuple[Ways, Ways], p: Array, clear: Mask | None = None
) -> tuple[Array, Array, Mask]:
    """ln (E − s S) − ln D, its derivatives by the parameters, and clear sightings.

    (N, 3), (N, 3, 7) and (N, 3). By default those are clear that are mostly the ground's own light.
    """
    light, beta = cells.light, np.exp(p[_BETA])
    direct, path, cosine = ways[0].sum(beta, p[0])
    scattered, path_scattered, _ = ways[1].sum(beta)
    added = scattering_factor(light, direct, p[_BETA], p[_SCATTERING]) * scattered
    if clear is None:
        clear = light - added > CLEAR_PART * light
    own = np.where(clear, np.maximum(light - added, OWN_PART * light), light)
    share = np.where(clear, (light - own) / own, 0.0)
    change = np.zeros((*light.shape, 7))
    change[..., 0] = -cosine + share * cosine.mean(axis=0)
    # Power changes with attenuation, since the observed light is fixed.
    by_beta = path - share * (1.0 / beta + path.mean(axis=0) - path_scattered)
    change[..., _BETA] = (by_beta * beta)[..., np.newaxis] * np.eye(3)
    change[..., _SCATTERING] = -share[..., np.newaxis] * np.eye(3)
    return np.log(own / direct), change, clear


def _in_error(cells: Sightings, error: float) -> Iterator[Sightings]:
    """Sightings off by a standard deviation: in range, and in the normal to either side.

    `error` is that of the inverse range of a patch of ground, 1/m.
    """
    relative = error * cells.range
    yield replace(cells, range=cells.range * (1.0 + relative))
    # A plane over a patch is as far off at its rims.
    tilt = (relative / np.maximum(cells.spread, 1e-6))[:, np.newaxis]
    for side in across(cells.normal):
        normal = cells.normal + tilt * side
        yield replace(cells, normal=normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _slope(jacobian: Array, weight: Array, change: Array) -> Array:
    """Derivatives (P,) of half the weighted squares of residuals (N, 3), by their change."""
    return np.asarray(np.einsum("nci,nc,nc->i", jacobian, weight, change, optimize=True))


def scattering_factor(
    light: Array, direct: Array, log_attenuation: Array, log_scattering: Array
) -> Array:
    """Factor s of S, (3,), given logarithms of β and of s over its usual value.

    Power is that of ground of usual reflectance, by light E and D, (N, 3) each.
    """
    power = np.exp(np.log(light / direct).mean(axis=0)) / REFLECTANCE
    # White shines with 1/π of its irradiance into each direction.
    return np.asarray(math.pi * ALBEDO * np.exp(log_attenuation + log_scattering) * power)


def less_means(values: Array, track: NDArray[np.int64], clear: Mask) -> Array:
    """Values (N, 3, ...) minus their mean over each track, scaled for the lost degree of freedom.

    0 where a sighting is not clear, (N, 3), or the only one of its track.
    """
    flat = values.reshape(*clear.shape, -1)
    out = np.zeros_like(flat)
    tracks = int(track.max()) + 1
    for c in range(3):
        seen = clear[:, c]
        number, some = track[seen], flat[seen, c]
        count = np.bincount(number, minlength=tracks)
        summed = np.stack([np.bincount(number, each, tracks) for each in some.T], axis=1)
        means = summed / np.maximum(count, 1)[:, np.newaxis]
        # A track of n frames has n − 1 ratios.
        wide = np.sqrt(count / np.maximum(count - 1, 1)) * (count > 1)
        out[seen, c] = (some - means[number]) * wide[number][:, np.newaxis]
    return out.reshape(values.shape)


def _ways_by_patches(cells: Sightings, lamps: Sequence[Lamp]) -> Ways:
    """Ways by four points of each patch of ground, whose mean is that of the patch."""
    parts = []
    height = np.einsum("nk,nk->n", cells.direction, cells.normal) * cells.range
    # Nodes of Gauss and Legendre's rule.
    step = cells.spread / math.sqrt(3.0)
    for x, y in itertools.product((-1.0, 1.0), repeat=2):
        away = cells.direction.copy()
        away[:, 0] += x * step
        away[:, 1] += y * step
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        slope = np.minimum(np.einsum("nk,nk->n", away, cells.normal), -0.02)
        far = np.minimum(height / slope, 3.0 * cells.range)
        parts.append(Ways.by_ground(away, far, cells.normal, lamps))
    ways = Ways(*map(np.concatenate, zip(*parts, strict=True)))
    return ways._replace(colour=ways.colour / len(parts))


def pool_tracks(frames: Sequence[Sightings], most: int) -> tuple[Sightings, NDArray[np.int64]]:
    """Pool points that several frames show, thinned by whole tracks to about `most` sightings.

    Tracks are numbered from 0. Also returns the group of each sighting, (N,): the part of the
    frames and of the image that it is in.
    """
    pooled = Sightings(*(
        np.concatenate([getattr(f, field.name) for f in frames]) for field in fields(Sightings)))
    number = np.repeat(np.arange(len(frames)), [len(f.range) for f in frames])
    _, track, count = np.unique(pooled.track, return_inverse=True, return_counts=True)
    several = count >= LEAST_FRAMES
    total = int(count[several].sum())
    share = most / max(total, most)
    keep = several & (np.arange(len(count)) * share % 1.0 < share)
    chosen = keep[track]
    pooled = replace(pooled.where(chosen), track=np.unique(track[chosen], return_inverse=True)[1])
    group = number[chosen] * FRAME_GROUPS // len(frames) * TILES**2 + pooled.tile
    return pooled, np.asarray(group)
