# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Posterior of the water's attenuation under lamps, from the light of nodes of one frame or many.

The light of a node is (see `uw_visibility.optics.lamps`)

    E = P ρ D + s S,   D = Σ cosᵏ(i) g(θ) e^(−β(r + d)) / r²

with the reflectance ρ of its patch, the incidence i of a lamp's light and an exponent k from 0 for
rough ground to 1 for Lambert's (Minnaert 1941, doi:10.1086/144279). ln ρ is modelled as a random
field: its differences on each scale (`Details`) have a variance that is fitted to the frame, so
that even ground gives a narrow posterior and patchy ground a wide one. Where scattered light hides
a patch, it hides the differences between patches, too.

For each of a grid of attenuations by particles the other unknowns are fitted: differences between
channels, k, scattered light and its spatial variation, errors of the lamps' parameters, and a trend
of ln ρ along the light's path, with a prior by the frame's texture. The posterior is summed over
the grid, with the rest marginalised by Laplace's approximation (Tierney and Kadane 1986,
doi:10.1080/01621459.1986.10478240).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.config.lighting import Lamp, LightingConfig
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.lamps import ATTENUATIONS, Ways, between, displaced, vector
from uw_visibility.water.estimate import one_sigma
from uw_visibility.water.lamps.nodes import WHITE, Nodes, details_of

# Attenuation by particles, 1/m: the grid, and prior mean and deviation of its logarithm (belief
# `lamps.particles` of the laboratory, wider). Refinements on both sides of the best point, and
# points of the interpolated posterior.
PARTICLES = np.geomspace(0.012, 1.5, 11)
USUAL_PARTICLES, PARTICLES_DEVIATION, REFINEMENTS, FINE = math.log(0.12), 1.0, 2, 400
# Relative deviations of a channel's attenuation by particles from the channels' mean, and of clear
# water's from its table.
CHANNEL_DEVIATION, CLEAR_WATER_DEVIATION = 0.3, 0.1
# Prior mean and deviation of the exponent k: from 0 to 1 (belief `lamps.exponent` of the
# laboratory), with the error of slopes.
USUAL_EXPONENT, EXPONENT_DEVIATION = 0.5, 0.5
# Deviation of ln light of a node by errors of the model: the tables' interpolation alone is off by
# 0.025 at some node of half of the rigs.
MODEL_DEVIATION = 0.03
# Reflectance of the ground and scattering over attenuation by particles, for the usual amount of
# scattered light; deviation of its logarithm: ground of 0.1 to 0.6, scattering of 0.4 to 0.95 and
# backscattering that differs by a factor of 2 between phase functions (beliefs `albedo`,
# `lamps.albedo`, `lamps.phase` of the laboratory); the part of single channels, as in the
# laboratory's scenes (`python -m uw_visibility_lab.posterior.lamps` prints it).
REFLECTANCE, ALBEDO, SCATTERING_DEVIATION, OF_CHANNELS = 0.3, 0.7, 1.0, 0.5
# Deviation of ln of scattered light that is linear in ln range, column and row: between the phase
# functions and beams of the laboratory 0.04 to 0.2.
COURSE_DEVIATION = 0.1
# Relative deviations of a beam's angle and of a lamp's power (beliefs `lamps.beam_error`,
# `lamps.power_error` of the laboratory), and number of principal components of the effect of these
# and of the lamps' places.
BEAM_DEVIATION, POWER_DEVIATION, DIRECTIONS = 0.2, 0.25, 3
# Largest number of steps of a fit, largest step of a parameter, and the step that ends the fit.
MOST_STEPS, LARGEST_STEP, CONVERGED = 40, 1.0, 0.02
# Nodes of the normal distributions that are summed for the clearest channel.
NORMAL = np.array([-1.6, -0.8, 0.0, 0.8, 1.6])
FEWEST_NODES = 30


class Fitted(NamedTuple):
    """Numbers fitted by `python -m uw_visibility_lab.posterior.lamps`: most likely over nights."""

    evidence: float = 0.133  # part of the nodes' differences that counts as independent
    # standard deviation of the trend of ln ρ along the path, over that of the random field
    trend: float = 3.0


FITTED = Fitted()
# Prior ratio of the differences' variance to that of the next finer scale, between white noise (1)
# and a random walk (4), its weight in differences, and its largest value. Least variance of a
# channel, and the largest one of ln ρ: algae and white sand are three deviations apart.
GROWTH, GROWTH_WEIGHT, MOST_GROWTH, LEAST_TEXTURE, MOST_TEXTURE = 2.0, 8.0, 4.0, 2e-4, 1.0
# Degrees of freedom of Student's distribution of the differences: with fewer, one of two
# reflectances of the ground is taken for outliers.
DEGREES = 6.0
# Least squared share of direct light.
LEAST_SHARE = 1e-6
# Two orthogonal directions of differences between channels.
_BETWEEN_CHANNELS = np.array([[1.0, -1.0, 0.0], [1.0, 1.0, -2.0]]) / np.sqrt([[2.0], [6.0]])


class Levels(NamedTuple):
    """Levels of light that go with one attenuation."""

    power: float  # irradiance of white at 1 m from a lamp of power 1, without water
    scattering: Array  # (3,), s
    daylight: Array  # (3,), irradiance of white by daylight; 0 without
    veil: Array  # (3,), irradiance of daylight's veil at infinity; 0 without


@dataclass(frozen=True, eq=False)
class LampPosterior:
    """Posterior of attenuation under lamps."""

    log_attenuation: Array  # (3,), mean of ln β, β in 1/m
    covariance: Array  # (3, 3), of ln β
    clearest: Array  # (3,), 16, 50 and 84 % of −ln min β over the channels seen
    exponent: float  # k
    scattering_stddev: Array  # (3,), of ln s
    # whether patches differ more than those of any ground, so that lamps or water are not as told
    misfit: bool
    # Levels for β, (3,), 1/m: of another one, what is restored would be too bright or too dark.
    levels: Callable[[Array], Levels]


class _Light(NamedTuple):
    """Light of lamps of power 1 at nodes for one attenuation, and daylight over it.

    ln of the light from the ground and from the water, and its derivatives by β, (2, L, N, 3) each:
    ln D at the usual exponent and ln S of the lamps, then of daylight, where there is any.
    d ln D / dk, (N, 3). Irradiance of white ground by daylight at the camera, (3,); 0 without.
    """

    logs: Array
    by_attenuation: Array
    by_exponent: Array
    white: Array


# Depths, m, whose colour of daylight in clear water starts the fit; each is as probable as no
# daylight. The usual veil is half as bright as white, here over the light of usual ground.
DEPTHS = (2.0, 15.0)
DAYLIGHT_VEIL = 0.5 / REFLECTANCE
# Deviation of ln of daylight over the lamps' light at the median range: two deviations are shares
# of 2 and 98 %. Deviation of ln of a channel's daylight from that in clear water at the best depth,
# and of ln of the veil over it, of all channels and of each: in waters of the laboratory.
DAYLIGHT_DEVIATION, DAYLIGHT_OF_CHANNELS = 2.0, 0.25
VEIL_DEVIATION, VEIL_OF_CHANNELS = 0.8, 0.25
# Derivatives of ln of both by their parameters, and the places of these in those of `fit`.
_DAYLIGHT_CHANGE, _VEIL_CHANGE = (
    np.column_stack((np.full(3, common), alone * np.eye(3))) for common, alone in (
        (DAYLIGHT_DEVIATION, DAYLIGHT_OF_CHANNELS), (VEIL_DEVIATION, VEIL_OF_CHANNELS)))
_DAYLIGHT, _VEIL = slice(-14, -10), slice(-10, -6)


def infer(
    frames: Sequence[Nodes], lighting: LightingConfig, clear_water: Array, seen: Mask,
    fitted: Fitted = FITTED,
) -> LampPosterior | None:
    """Infer attenuation from the nodes of frames in the order of time; None with too few nodes.

    With `lighting.model` ``both`` the posterior is summed over depths of daylight. `clear_water` is
    κ, (3,), 1/m; among the channels `seen`, (3,), the clearest one is sought.
    """
    if sum(len(nodes.range) for nodes in frames) < FEWEST_NODES:
        return None
    # Consecutive frames show the same ground: they count as one frame with all ranges.
    fitted = fitted._replace(evidence=fitted.evidence / len(frames))
    scene = _Scene(frames, lighting, clear_water)
    depths = (None, *DEPTHS) if lighting.model == "both" else (None,)
    grids = [_over_grid(scene, depth, fitted) for depth in depths]
    return _summed(grids, depths, scene, seen)


def rigs_in_error(lighting: LightingConfig) -> list[list[Lamp]]:
    """Rigs off by a standard deviation: of a lamp's place, axis or power, or of all beams."""
    lamps = list(lighting.lamps())
    rigs = displaced(lamps, lighting.position_stddev, lighting.direction_stddev)
    rigs.append([
        lamp._replace(beam_angle=min(lamp.beam_angle * (1.0 + BEAM_DEVIATION), 360.0))
        for lamp in lamps])
    for i, lamp in enumerate(lamps if len(lamps) > 1 else []):
        stronger = lamp._replace(colour=vector((1.0 + POWER_DEVIATION) * np.array(lamp.colour)))
        rigs.append([*lamps[:i], stronger, *lamps[i + 1 :]])
    return rigs


def course_of_scattered(distance: Array, direction: Array) -> Array:
    """Deviations of ln of scattered light, (N, 3): linear in ln range (N,), column and row."""
    course = np.column_stack((np.log(distance), direction[:, :2]))
    course -= course.mean(axis=0)
    return np.asarray(COURSE_DEVIATION * course / np.maximum(course.std(axis=0), 1e-6))


class _Scene:
    """Nodes of frames, and their light by lamps in water that is at best clear, κ, (3,), 1/m."""

    def __init__(
        self, frames: Sequence[Nodes], lighting: LightingConfig, clear_water: Array
    ) -> None:
        def joined(name: str) -> Array:
            return np.concatenate([getattr(nodes, name) for nodes in frames], axis=0)

        self.log_light, self.log_bright = np.log(joined("light")), np.log(joined("bright"))
        self.details = details_of([nodes.place for nodes in frames])
        self.variance = joined("variance")
        self.range = joined("range")
        self.log_scattered = np.concatenate([nodes.log_scattered for nodes in frames], axis=2)
        self.clear_water = clear_water
        directions, normals = joined("direction"), joined("normal")
        self._ground = Ways.by_ground(directions, self.range, normals, list(lighting.lamps()))
        self.moved = self._main_directions(directions, normals, lighting)
        self.course = course_of_scattered(self.range, directions)

    def _main_directions(
        self, directions: Array, normals: Array, lighting: LightingConfig
    ) -> Array:
        """Principal components of ln D by lamps off by a standard deviation, (N, M)."""

        def log_direct(rig: list[Lamp]) -> Array:
            ways = Ways.by_ground(directions, self.range, normals, rig)
            grey = ways._replace(
                colour=ways.colour.mean(axis=1, keepdims=True), log_cosine=self._ground.log_cosine)
            light, _, _ = grey.sum(np.exp([USUAL_PARTICLES]), USUAL_EXPONENT)
            return np.log(light[:, 0])

        first = log_direct(list(lighting.lamps()))
        changes = np.array([log_direct(rig) - first for rig in rigs_in_error(lighting)])
        # A change common to all nodes has no information.
        left, _, _ = np.linalg.svd(
            changes - changes.mean(axis=1, keepdims=True), full_matrices=False)
        return np.ascontiguousarray((left[:, :DIRECTIONS].T @ changes).T)

    def light(self, attenuation: Array, depth: float | None) -> _Light:
        """Light at attenuations (3,), of lamps and of daylight at a depth, m."""
        rough, lambertian = (
            np.log(self._ground.sum(attenuation, exponent)[0]) for exponent in (0.0, 1.0))
        by_exponent = lambertian - rough
        _, path, _ = self._ground.sum(attenuation, USUAL_EXPONENT)
        direct = rough + USUAL_EXPONENT * by_exponent
        low, part, step = between(np.clip(attenuation, ATTENUATIONS[0], ATTENUATIONS[-1]))
        channel = np.arange(3)
        near, far = self.log_scattered[low, channel], self.log_scattered[low + 1, channel]
        scattered = ((1 - part)[:, np.newaxis] * near + part[:, np.newaxis] * far).T
        slope = ((far - near) / step[:, np.newaxis]).T
        logs, by_attenuation = np.array([[direct], [scattered]]), np.array([[-path], [slope]])
        if depth is None:
            return _Light(logs, by_attenuation, by_exponent, np.zeros(3))
        # Daylight of the depth's colour, as strong as the lamps at the median range.
        distance = np.repeat(self.range[:, np.newaxis], 3, axis=1)
        lost = attenuation * distance
        level = float((np.median(direct, axis=0) + np.median(lost, axis=0)).mean())
        colour = (self.clear_water.min() - self.clear_water) * depth
        light, left = level + colour, np.exp(-lost)
        veil = light + np.log(DAYLIGHT_VEIL * (1.0 - left))
        return _Light(
            np.append(logs, [[light - lost], [veil]], axis=1),
            np.append(by_attenuation, [[-distance], [distance * left / (1.0 - left)]], axis=1),
            by_exponent, np.exp(light))

    def parts(self, light: _Light, to_channels: Array, usual: float) -> tuple[Array, Array]:
        """Logarithms of the light's parts, (2, L, N, 3), and derivatives by parameters of `fit`.

        From the ground and from the water, each by lamps and, where there is any, by daylight.
        Derivatives are (2, L, N, 3, P). `to_channels` (3, 2) maps the first two parameters to
        changes of β; `usual` is ln of the usual amount of scattered light.
        """
        path = -light.by_attenuation[0, 0].mean(axis=1)
        trend = (path - path.mean()) / max(float(path.std()), 1e-6)
        moved, bent = self.moved.shape[1], self.course.shape[1]
        by_day = light.logs.shape[1] > 1
        count = 9 + moved + bent + 8 * by_day
        ground, water = changes = np.zeros((*light.logs.shape, count))
        changes[..., :2] = light.by_attenuation[..., np.newaxis] * to_channels
        ground[..., -3:] = trend[:, np.newaxis, np.newaxis] * np.eye(3)
        water[..., -6:-3] = np.eye(3)
        ground[0, ..., 2] = light.by_exponent
        ground[0, ..., 3:3 + moved] = self.moved[:, np.newaxis]
        water[0, ..., 3 + moved:3 + moved + bent] = self.course[:, np.newaxis]
        logs = light.logs.copy()
        logs[1, 0] += usual
        if by_day:
            water[1, ..., -6:-3] = 0.0
            ground[1, ..., _DAYLIGHT] = water[1, ..., _DAYLIGHT] = _DAYLIGHT_CHANGE
            water[1, ..., _VEIL] = _VEIL_CHANGE
        return logs, changes


def _usual_scattering(particles: float) -> float:
    """ln of the usual amount of scattered light over ground of usual reflectance."""
    return math.log(math.pi * ALBEDO * particles / REFLECTANCE)


class _Fit(NamedTuple):
    """Fit at one attenuation by particles."""

    particles: float  # 1/m
    evidence: float  # logarithm
    attenuation: Array  # (3,), β
    covariance: Array  # (3, 3), of β
    parameters: Array  # (P,), see `fit`
    scattering_variance: Array  # (3,), of ln of the amount of scattered light
    texture: Array  # (L, 3, 3), see `fit`


def _over_grid(scene: _Scene, depth: float | None, fitted: Fitted) -> list[_Fit]:
    """Fit the other unknowns over `PARTICLES`, each started at its neighbours; refine the best.

    `depth`, m, gives the colour of daylight; None without daylight.

    A frame may have two solutions, with much scattered light and with little. Starting from one
    side finds only one of them.
    """
    clear_water, levels = scene.clear_water, int(scene.details.level.max(initial=-1)) + 1

    def fit_at(particles: float, start: _Fit | None) -> _Fit:
        apart = np.hypot(CHANNEL_DEVIATION * particles, CLEAR_WATER_DEVIATION * clear_water)
        to_channels = (_BETWEEN_CHANNELS * apart).T
        light = scene.light(clear_water + particles, depth)
        logs, changes = scene.parts(light, to_channels, _usual_scattering(particles))
        p, texture = np.zeros(changes.shape[-1]), np.zeros((levels, 3, 3))
        if start is not None:
            p, texture = start.parameters.copy(), start.texture.copy()
        if not texture.any():
            texture[:] = _first_texture(scene.log_light - np.logaddexp.reduce(logs, axis=(0, 1)))
        evidence, precision = fit(
            scene.log_light, scene.variance, logs, changes, scene.details, fitted, p, texture)
        if not math.isfinite(evidence):
            # Its weight is 0, and the next fit starts from zero.
            evidence, precision = -math.inf, np.eye(len(p))
            p[:], texture[:] = 0.0, 0.0
        covariance = np.linalg.inv(precision)
        return _Fit(
            particles, evidence,
            np.maximum(clear_water + particles + to_channels @ p[:2], 0.5 * clear_water),
            to_channels @ covariance[:2, :2] @ to_channels.T, p, np.diag(covariance)[-6:-3],
            texture)

    fits: list[_Fit] = []
    for particles in PARTICLES:
        fits.append(fit_at(float(particles), fits[-1] if fits else None))
    for i in range(len(fits) - 2, -1, -1):
        fits[i] = max(
            fits[i], fit_at(fits[i].particles, fits[i + 1]), key=lambda each: each.evidence)
    for _ in range(REFINEMENTS):
        best = int(np.argmax([each.evidence + _expected(each.particles) for each in fits]))
        fresh = [
            fit_at(math.sqrt(fits[best].particles * fits[other].particles), fits[best])
            for other in (best - 1, best + 1) if 0 <= other < len(fits)]
        fits = sorted([*fits, *fresh], key=lambda each: each.particles)
    return fits


def _first_texture(residual: Array) -> Array:
    """Covariance (3, 3) of ln ρ by robust deviations of nodes (N, 3): common and of channels."""
    away = residual - np.median(residual, axis=0)
    common = away.mean(axis=1)
    # Of a normal distribution, 1.48 median absolute deviations are one standard deviation.
    both = 0.5 * (1.48 * np.median(np.abs(common))) ** 2 + 1e-3
    alone = (1.48 * np.median(np.abs(away - common[:, np.newaxis]))) ** 2 + 1e-4
    return np.asarray(both + alone * np.eye(3))


def _expected(particles: float) -> float:
    """Log prior density of ln attenuation by particles, up to a constant."""
    return -0.5 * ((math.log(particles) - USUAL_PARTICLES) / PARTICLES_DEVIATION) ** 2


def _summed(
    grids: Sequence[list[_Fit]], depths: Sequence[float | None], scene: _Scene, seen: Mask
) -> LampPosterior | None:
    """Sum the posterior over the grid, interpolated, and over kinds of daylight."""
    fine = np.linspace(math.log(PARTICLES[0]), math.log(PARTICLES[-1]), FINE)
    highest = max(each.evidence for grid in grids for each in grid)
    if not math.isfinite(highest):
        return None
    evidence, mean, covariance = (np.concatenate(each) for each in zip(*(
        _interpolated(grid, highest, fine) for grid in grids), strict=True))
    weight = np.exp(evidence - evidence.max())
    weight /= weight.sum()
    middle = weight @ mean
    away = mean - middle
    spread = np.tensordot(weight, covariance, 1) + (weight[:, np.newaxis] * away).T @ away
    most = int(np.argmax(weight))
    grid, depth = grids[most // FINE], depths[most // FINE]
    best = min(grid, key=lambda each: abs(math.log(each.particles) - fine[most % FINE]))
    texture = np.trace(best.texture, axis1=1, axis2=2)
    misfit = bool((texture > 0.99 * _most_texture(np.arange(len(texture)))).any())
    return LampPosterior(
        middle, spread, _of_clearest(weight, mean, covariance, seen),
        USUAL_EXPONENT + float(best.parameters[2]), np.sqrt(best.scattering_variance), misfit,
        partial(_levels, scene, seen, best, depth))


def _levels(
    scene: _Scene, seen: Mask, best: _Fit, depth: float | None, attenuation: Array
) -> Levels:
    """Levels of light for an attenuation, (3,), with the other parameters of a fit."""
    p, light = best.parameters, scene.light(attenuation, depth)
    amount = _usual_scattering(best.particles) + p[-6:-3]
    cosine = (USUAL_EXPONENT + p[2]) * light.by_exponent
    ground, water = light.logs
    direct, scattered = ground[0] + light.by_exponent * p[2], water[0] + amount
    daylight = veil = np.zeros(3)
    if depth is not None:
        change, over_light = _DAYLIGHT_CHANGE @ p[_DAYLIGHT], _VEIL_CHANGE @ p[_VEIL]
        both = np.logaddexp(direct, ground[1] + change)
        cosine *= np.exp(direct - both)
        direct, daylight = both, light.white * np.exp(change)
        veil = DAYLIGHT_VEIL * daylight * np.exp(over_light)
        scattered = np.logaddexp(scattered, water[1] + change + over_light)
    log_level = np.median(scene.log_light - np.logaddexp(direct, scattered), axis=0)
    level = np.exp(log_level)
    # Images are restored with ground facing the lamps.
    facing = direct - cosine
    usual = level * np.exp(np.median(cosine, axis=0))
    with np.errstate(over="ignore", invalid="ignore"):
        own = np.exp(scene.log_bright - facing) - np.exp(log_level + scattered - facing)
    clear = (direct > scattered) & np.isfinite(own) & seen
    # Ground has a colour, and no channel of it is brighter than white.
    brightest = np.where(clear, own, -np.inf)[clear.any(axis=1)].max(axis=1)
    power = float(np.exp(np.log(usual[seen]).mean()))
    power = (
        max(float(np.quantile(brightest, WHITE)), power) if len(brightest)
        else power / REFLECTANCE)
    return Levels(power, level * np.exp(amount), power * daylight * level / usual, level * veil)


def _interpolated(grid: list[_Fit], highest: float, fine: Array) -> tuple[Array, Array, Array]:
    """Log density (D,), mean (D, 3) and covariance (D, 3, 3) of ln β, over ln particles."""
    # Its import takes 0.4 s, which by daylight nobody needs.
    from scipy.interpolate import PchipInterpolator, make_interp_spline

    evidence = np.array([
        max(each.evidence - highest, -1e3) + _expected(each.particles) for each in grid])
    mean = np.log([each.attenuation for each in grid])
    nodes = np.log([each.particles for each in grid])
    covariance = np.array([
        each.covariance / np.outer(each.attenuation, each.attenuation) for each in grid])

    # Without overshoot; a covariance stays one by linear interpolation.
    return (
        PchipInterpolator(nodes, evidence)(fine), PchipInterpolator(nodes, mean)(fine),
        make_interp_spline(nodes, covariance, k=1)(fine))


def _of_clearest(weight: Array, mean: Array, covariance: Array, seen: Mask) -> Array:
    """16, 50 and 84 % of −ln min β over the channels seen."""
    channel = np.argmin(np.where(seen, mean, np.inf), axis=1)
    each = np.arange(len(mean))
    deviation = np.sqrt(covariance[each, channel, channel])
    values = (-mean[each, channel, np.newaxis] + deviation[:, np.newaxis] * NORMAL).ravel()
    parts = np.exp(-0.5 * NORMAL**2)
    return one_sigma(values, (weight[:, np.newaxis] * parts / parts.sum()).ravel())


@njit(nogil=True, error_model="numpy")
def fit(
    log_light: Any, variances: Any, logs: Any, changes: Any, details: Any, fitted: Any, p: Any,
    texture: Any,
) -> tuple[float, Any]:
    """Fit the unknowns beside the attenuation by particles, `p`, and the texture, both in place.

    Fisher's scoring of the details of ln E (Student's distribution: Lange, Little and Taylor 1989,
    doi:10.1080/01621459.1989.10478852): of their means, and of their variance, which falls with the
    ground's share of the light. The covariance of ln ρ of each scale, `texture` (L, 3, 3), is
    fitted along.

    `log_light` and `variances` (N, 3) are ln E and its variance; for `logs` and `changes` see
    `_Scene.parts`. `p` (P,) are differences of β (2), change of the exponent, displacements of
    lamps (M), variation of scattered light (K), ln of daylight and of its veil (4 and 4, where
    there is any), ln of the amount of scattered light over the usual one (3), trends of ln ρ (3).
    Returns the logarithm of the evidence, NaN where the fit fails, and the precision of `p`.
    """
    _, lights, number, _, count = changes.shape
    residual, share = np.empty((number, 3)), np.empty((number, 3))
    jacobian, by_share = np.empty((number, 3, count)), np.empty((number, 3, count))
    parts = np.empty((2, lights))
    r, own, noise = np.empty(3), np.empty(3), np.empty(3)
    x, wx = np.empty((3, count)), np.empty((3, count))
    g, wg = np.empty((3, count)), np.empty((3, count))
    variance, weight = np.empty((3, 3)), np.empty((3, 3))
    for step in range(MOST_STEPS):
        for i in range(number):
            for c in range(3):
                total = -math.inf
                for k in range(2):
                    for m in range(lights):
                        part = logs[k, m, i, c]
                        for j in range(count):
                            part += changes[k, m, i, c, j] * p[j]
                        parts[k, m], total = part, np.logaddexp(total, part)
                residual[i, c], share[i, c] = log_light[i, c] - total, 0.0
                jacobian[i, c], by_share[i, c] = 0.0, 0.0
                for k in range(2):
                    for m in range(lights):
                        part = math.exp(parts[k, m] - total)
                        if k == 0:
                            share[i, c] += part
                        for j in range(count):
                            jacobian[i, c, j] += part * changes[k, m, i, c, j]
                            if k == 0:
                                by_share[i, c, j] += part * changes[k, m, i, c, j]
                for j in range(count):
                    by_share[i, c, j] -= share[i, c] * jacobian[i, c, j]
                    by_share[i, c, j] *= share[i, c]
                share[i, c] *= share[i, c]
        prior = _expect(fitted, texture[-1] / number, count)
        precision, slope, likelihood = prior.copy(), -prior @ p, 0.0
        gathered, gathered_weight = np.zeros_like(texture), np.zeros(len(texture))
        scales, of_scales = np.zeros_like(texture), np.zeros((len(texture), 3, count))
        scores = np.zeros((len(texture), 3))
        for row in range(len(details.level)):
            level = details.level[row]
            _take(
                variances, residual, jacobian, share, by_share, details, row, r, x, own, noise, g)
            scale, relative = 0.0, 0.0
            for c in range(3):
                scale += texture[level, c, c] / 3.0
                relative += noise[c] / (own[c] * own[c]) / 3.0
                for j in range(3):
                    variance[c, j] = texture[level, c, j] * own[c] * own[j]
                variance[c, c] += noise[c]
            determinant = _invert(variance, weight)
            distance = 0.0
            for c in range(3):
                for j in range(3):
                    distance += r[c] * weight[c, j] * r[j]
            likelihood -= 0.5 * (
                math.log(determinant) + (DEGREES + 3.0) * math.log1p(distance / DEGREES))
            robust = (DEGREES + 3.0) / (DEGREES + distance)
            for c in range(3):
                for j in range(count):
                    wx[c, j] = robust * fitted.evidence * (
                        weight[c, 0] * x[0, j] + weight[c, 1] * x[1, j] + weight[c, 2] * x[2, j])
            for i in range(count):
                for c in range(3):
                    slope[i] += wx[c, i] * r[c]
                    for j in range(i + 1):
                        precision[i, j] += wx[c, i] * x[c, j]
            # Patches that are hidden by scattered light differ less. Score and information of ln of
            # the ground's share in each channel, which scales the ground's part of the variance:
            u = weight @ r
            for c in range(3):
                variance[c, c] -= noise[c]
            ground = weight @ variance
            square = variance @ ground
            for c in range(3):
                score = fitted.evidence * (
                    robust * u[c] * (r[c] - noise[c] * u[c]) - 1.0 + noise[c] * weight[c, c])
                scores[level, c] += score
                for j in range(count):
                    slope[j] += score * g[c, j]
                    wg[c, j] = 0.0
                for k in range(3):
                    both = fitted.evidence / (DEGREES + 5.0) * (
                        (DEGREES + 3.0)
                        * (ground[c, k] * ground[k, c] + weight[c, k] * square[c, k])
                        - 2.0 * ground[c, c] * ground[k, k])
                    scales[level, c, k] += both
                    for j in range(count):
                        wg[c, j] += both * g[k, j]
                of_scales[level, c] += wg[c]
                for i in range(count):
                    for j in range(i + 1):
                        precision[i, j] += wg[c, i] * g[c, j]
            # Differences that are mostly noise have little weight in the texture.
            part = scale / (scale + relative + 1e-12)
            gathered_weight[level] += part
            for c in range(3):
                for j in range(3):
                    gathered[level, c, j] += robust * part * r[c] * r[j] / (own[c] * own[j])
        for i in range(count):
            for j in range(i):
                precision[j, i] = precision[i, j]
        if not (np.isfinite(slope).all() and np.isfinite(precision).all()):
            return math.nan, precision
        # What a change of the texture of a scale explains as well tells nothing.
        for level in range(len(texture)):
            left = np.linalg.solve(scales[level] + 1e-9 * np.eye(3), of_scales[level])
            precision -= of_scales[level].T @ left
            slope -= scores[level] @ left
        change = np.linalg.solve(precision, slope)
        change = np.minimum(np.maximum(change, -LARGEST_STEP), LARGEST_STEP)
        if step == MOST_STEPS - 1 or np.abs(change).max() < CONVERGED:
            break
        p += change
        _update_texture(gathered, gathered_weight, texture)
    evidence = fitted.evidence * likelihood - 0.5 * (
        p @ prior @ p + np.linalg.slogdet(precision)[1] - np.linalg.slogdet(prior)[1])
    return evidence, precision


@njit(nogil=True, error_model="numpy")
def _expect(fitted: Any, texture: Any, count: int) -> Any:
    """Prior precision of the parameters; `texture` is that of trends along nodes."""
    prior = np.eye(count)
    prior[2, 2] = 1.0 / EXPONENT_DEVIATION**2
    common = max((texture[1, 0] + texture[2, 0] + texture[2, 1]) / 3.0, 0.0)
    alone = max(np.trace(texture) / 3.0 - common, 0.0)
    trend = fitted.trend**2
    # Three parameters each, with a common variance and an own one.
    for first, shared, own in (
        (count - 6, SCATTERING_DEVIATION**2, OF_CHANNELS**2),
        (count - 3, trend * (common + LEAST_TEXTURE), trend * (alone + LEAST_TEXTURE)),
    ):
        for i in range(3):
            for j in range(3):
                prior[first + i, first + j] = -shared / (own + 3.0 * shared) / own
            prior[first + i, first + i] += 1.0 / own
    return prior


@njit(nogil=True, error_model="numpy")
def _take(
    variances: Any, residual: Any, jacobian: Any, share: Any, by_share: Any, details: Any,
    row: int, r: Any, x: Any, own: Any, noise: Any, g: Any,
) -> None:
    """Residual, Jacobian, share of direct light and noise variance of a difference.

    `g` (3, P) are the derivatives of ln of that share.
    """
    r[:], own[:], noise[:], x[:], g[:] = 0.0, LEAST_SHARE, MODEL_DEVIATION**2, 0.0, 0.0
    for k in range(details.first[row], details.first[row + 1]):
        node, weight = details.node[k], details.weight[k]
        for c in range(3):
            r[c] += weight * residual[node, c]
            own[c] += weight * weight * share[node, c]
            noise[c] += weight * weight * variances[node, c]
            for j in range(x.shape[1]):
                x[c, j] += weight * jacobian[node, c, j]
                g[c, j] += weight * weight * by_share[node, c, j]
    for c in range(3):
        g[c] /= own[c]
    own[:] = np.sqrt(own)


@njit(nogil=True, error_model="numpy")
def _most_texture(level: Any) -> Any:
    """Largest trace of the covariance of a scale."""
    # Differences of means are weighted by the root of their number of nodes.
    return 3.0 * MOST_TEXTURE * 4.0**level


@njit(nogil=True, error_model="numpy")
def _update_texture(gathered: Any, weight: Any, texture: Any) -> None:
    """Update the covariance of each scale; its prior is that of the next finer one, grown."""
    growth = GROWTH
    for level in range(len(texture)):
        texture[level] = gathered[level] + LEAST_TEXTURE * np.eye(3)
        degrees = 0.0
        if level > 0:
            degrees = GROWTH_WEIGHT
            texture[level] += degrees * growth * texture[level - 1]
        texture[level] /= weight[level] + degrees + 1.0
        texture[level] *= min(1.0, _most_texture(level) / np.trace(texture[level]))
        if level > 0:
            growth = np.trace(texture[level]) / np.trace(texture[level - 1])
            growth = min(max(growth, 1.0), MOST_GROWTH)


@njit(nogil=True, error_model="numpy")
def _invert(matrix: Any, inverse: Any) -> float:
    """Invert a symmetric matrix of three; return its determinant."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    first, second, third = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * first + b * second + c * third
    inverse[0, 0], inverse[1, 1], inverse[2, 2] = first, a * f - c * c, a * d - b * b
    inverse[0, 1] = inverse[1, 0] = second
    inverse[0, 2] = inverse[2, 0] = third
    inverse[1, 2] = inverse[2, 1] = b * c - a * e
    inverse /= determinant
    return determinant
