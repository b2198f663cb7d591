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
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.robust import charbonnier_weight, median_deviation
from uw_visibility.config.lighting import Lamp, LightingConfig
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.lamps import Ways, displaced
from uw_visibility.water.lamps.posterior import (
    ALBEDO,
    EXPONENT_DEVIATION,
    PARTICLES_DEVIATION,
    REFLECTANCE,
    USUAL_EXPONENT,
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
# Deviation of unmodelled trends of the ground's light along the path, 1/m: common to the channels,
# and of each.
TREND, CHANNEL_TREND = 0.015, 0.004
ITERATIONS = 30


@dataclass(frozen=True)
class TrackFit:
    """Attenuation (3,), 1/m, from tracked points, and its covariance."""

    attenuation: Array
    covariance: Array


def fit_tracks(frames: Sequence[Sightings], lighting: LightingConfig) -> TrackFit | None:
    """Fit attenuation to points in frames in the order of time, under lamps without daylight.

    None with too few points, or if they do not fit the lamps.
    """
    if len(frames) < LEAST_FRAMES:
        return None
    cells, group = pool_tracks(frames, MOST_SIGHTINGS)
    if len(cells.range) < FEWEST_SIGHTINGS:
        return None
    lamps = list(lighting.lamps())
    ground = _ways_by_patches(cells, lamps)
    water = Ways.by_water(cells.direction, cells.range, lamps)
    p = START
    for _ in range(ITERATIONS):
        residual, jacobian, clear = _residuals(cells, ground, water, p)
        if clear.sum() < 3 * FEWEST_SIGHTINGS:
            return None
        scatter = max(median_deviation(residual[clear]), LEAST_SCATTER)
        weight = charbonnier_weight(residual / scatter) / (scatter * TOGETHER) ** 2
        curvature = np.einsum("nci,nc,ncj->ij", jacobian, weight, jacobian, optimize=True)
        slope = -np.einsum("nci,nc,nc->i", jacobian, weight, residual, optimize=True)
        curvature += np.diag(_PRIOR)
        step = np.clip(np.linalg.solve(curvature, slope - _PRIOR * (p - START)), -0.5, 0.5)
        p = p + step
        if np.abs(step).max() < 1e-3:
            break
    if scatter > MOST_SCATTER:
        return None
    bread, covariance = sandwich(jacobian, weight, residual, group, _PRIOR)
    beta = np.exp(p[_BETA])
    direct, _, _ = ground.sum(beta, p[0])
    for moved in displaced(lamps, lighting.position_stddev, lighting.direction_stddev):
        other, _, _ = _ways_by_patches(cells, moved).sum(beta, p[0])
        change = less_means(np.log(other / direct), cells.track, clear)
        shift = bread @ np.einsum("nci,nc,nc->i", jacobian, weight, change, optimize=True)
        covariance += np.outer(shift, shift)
    found = np.outer(beta, beta) * covariance[_BETA, _BETA]
    return TrackFit(beta, found + TREND**2 + CHANNEL_TREND**2 * np.eye(3))


# Parameters: exponent of the cosine, logarithms of β, logarithms of s over its usual value; what
# they are beforehand, and its deviation.
_BETA, _SCATTERING = slice(1, 4), slice(4, 7)
START = np.array([USUAL_EXPONENT, *[USUAL_ATTENUATION] * 3, 0.0, 0.0, 0.0])
DEVIATION = np.array([EXPONENT_DEVIATION, *[PARTICLES_DEVIATION] * 3, *[SCATTERING] * 3])
_PRIOR = 1.0 / DEVIATION**2


def _residuals(cells: Sightings, ground: Ways, water: Ways, p: Array) -> tuple[Array, Array, Mask]:
    """Residuals ln (E − s S) − ln D less their track's mean, Jacobian, and clear sightings.

    (N, 3), (N, 3, 7) and (N, 3).
    """
    light, beta = cells.light, np.exp(p[_BETA])
    direct, path, cosine = ground.sum(beta, p[0])
    scattered, path_scattered, _ = water.sum(beta)
    added = scattering_factor(light, direct, p[_BETA], p[_SCATTERING]) * scattered
    clear = light - added > CLEAR_PART * light
    own = np.where(clear, light - added, light)
    share = np.where(clear, added / own, 0.0)
    jacobian = np.zeros((*light.shape, 7))
    jacobian[..., 0] = -cosine + share * cosine.mean(axis=0)
    # Power changes with attenuation, since the observed light is fixed.
    by_beta = path - share * (1.0 / beta + path.mean(axis=0) - path_scattered)
    jacobian[..., _BETA] = (by_beta * beta)[..., np.newaxis] * np.eye(3)
    jacobian[..., _SCATTERING] = -share[..., np.newaxis] * np.eye(3)
    residual = less_means(np.log(own / direct), cells.track, clear)
    return residual, less_means(jacobian, cells.track, clear), clear


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


def sandwich(
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
