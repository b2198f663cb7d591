# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Posterior under lamps, from nodes whose light is set by the model."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from lamp_scene import CLEAR_WATER, LAMPS, RIG, parameters

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.optics.lamps import ATTENUATIONS, shine
from uw_visibility.water.lamps.nodes import Nodes, details_of
from uw_visibility.water.lamps.posterior import FITTED, LampPosterior, Levels, fit, infer

LIGHTING = PipelineConfig.from_parameters(parameters(LAMPS)).lighting
ALL = np.ones(3, bool)


def nodes(
    particles: float, texture: float = 0.05, exponent: float = 0.0, seed: int = 0,
    near: float = 1.2, far: float = 7.0, trend: float = 0.0, scattering: float = 1e-4,
    daylight: float = 0.0, veil: float = 0.5,
) -> Nodes:
    """Ground from a near to a far range, in the model's own light.

    `daylight` is its share in the ground's light, and `veil` that of open water over it.
    """
    rng = np.random.default_rng(seed)
    place = np.argwhere(np.ones((16, 20), bool))
    column, row = 10.0 * place[:, 1], 9.0 * place[:, 0]
    direction = np.array([RIG.rays_at(np.array([x]), np.array([y]))[0, 0]
                          for x, y in zip(column, row, strict=True)])
    distance = np.geomspace(far, near, 16)[place[:, 0]]
    normal = -direction + np.array([0.0, -0.6, 0.0]) + 0.3 * rng.standard_normal(direction.shape)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    points = direction * distance[:, np.newaxis]
    beta = CLEAR_WATER + particles
    light = np.zeros((len(place), 3))
    for lamp in LIGHTING.lamps():
        r, lit, _ = (each[:, 0] for each in shine(points[:, None], direction, lamp))
        away = points - np.array(lamp.position)
        cosine = np.maximum(-np.einsum("nk,nk->n", away, normal) / r, 0.05)
        light += (lit * cosine**exponent)[:, None] * np.exp(-np.outer(r + distance, beta))
    albedo = np.exp(
        texture * rng.standard_normal(len(place)) + trend * np.log(distance))[:, None]
    scattered = np.log(scattering * (1.0 - np.exp(-0.3 * distance)))
    # Of a colour that clear water alone does not give it.
    left = np.exp(-np.outer(distance, beta))
    day = (daylight / (1.0 - daylight) * light.mean() / left.mean()
           * np.array([0.6, 1.0, 0.7]))
    shown = 0.3 * (albedo * (light + day * left) + day * veil * (1.0 - left))
    shown += np.exp(scattered)[:, None]
    return Nodes(
        place, shown, shown, np.full((len(place), 3), 1e-6), distance, direction, normal,
        np.broadcast_to(scattered, (len(ATTENUATIONS), 3, len(place))).copy(),
        np.zeros((len(ATTENUATIONS), 3)))


def found(*frames: Nodes) -> LampPosterior:
    posterior = infer(list(frames), LIGHTING, CLEAR_WATER, ALL)
    assert posterior is not None
    return posterior


def told(shown: Nodes) -> Levels:
    posterior = found(shown)
    return posterior.levels(np.exp(posterior.log_attenuation))


@pytest.mark.parametrize("particles", [0.05, 0.15, 0.5])
@pytest.mark.parametrize("exponent", [0.0, 1.0])
def test_even_ground_tells_attenuation_however_it_reflects(
    particles: float, exponent: float
) -> None:
    posterior = found(nodes(particles, exponent=exponent))
    error = np.exp(posterior.log_attenuation) - CLEAR_WATER - particles
    assert (np.abs(error) < 0.2 * particles + 0.005).all()
    deviation = np.sqrt(np.diag(posterior.covariance))
    assert (np.abs(posterior.log_attenuation - np.log(CLEAR_WATER + particles))
            < 3.0 * deviation).all()
    assert abs(posterior.exponent - exponent) < 0.25


def test_patchy_ground_is_less_sure_and_the_truth_within() -> None:
    scores, deviations = [], []
    for seed in range(6):
        for texture in (0.05, 0.5):
            posterior = found(nodes(0.15, texture, seed=seed))
            deviations.append(math.sqrt(posterior.covariance[2, 2]))
            scores.append(
                (posterior.log_attenuation[2] - math.log(CLEAR_WATER[2] + 0.15)) / deviations[-1])
    assert np.mean(deviations[1::2]) > 1.5 * np.mean(deviations[0::2])
    assert np.sqrt(np.mean(np.square(scores))) < 1.3
    assert np.abs(scores).max() < 3.0


def test_exposure_tells_nothing_and_scales_what_it_should() -> None:
    shown = nodes(0.15, 0.2)
    one, other = found(shown), found(replace(
        shown, light=0.25 * shown.light, bright=0.25 * shown.bright))
    np.testing.assert_allclose(other.log_attenuation, one.log_attenuation, atol=1e-6)
    bright, dim = (
        posterior.levels(np.exp(one.log_attenuation)) for posterior in (one, other))
    np.testing.assert_allclose(dim.power, 0.25 * bright.power, rtol=1e-5)
    np.testing.assert_allclose(dim.scattering, 0.25 * bright.scattering, rtol=1e-5)


@pytest.mark.parametrize("factor", [1.0, 1.2])
@pytest.mark.parametrize("particles", [0.09, 0.13, 0.19])
def test_power_is_that_of_the_attenuation_which_ground_is_restored_with(
    particles: float, factor: float
) -> None:
    # Scattered light hides none of it.
    shown = nodes(particles, 0.2, far=4.0)
    posterior = found(shown)
    beta = factor * np.exp(posterior.log_attenuation)
    levels = posterior.levels(beta)
    facing = np.zeros_like(shown.light)
    for lamp in LIGHTING.lamps():
        points = shown.direction * shown.range[:, np.newaxis]
        r, lit, _ = (each[:, 0] for each in shine(points[:, None], shown.direction, lamp))
        facing += lit[:, None] * np.exp(-np.outer(r + shown.range, beta))
    scattered = levels.scattering * np.exp(shown.log_scattered[0].T)
    restored = (shown.bright - scattered) / (levels.power * facing)
    # No more than one in twenty of the nodes is brighter than white.
    np.testing.assert_allclose(np.quantile(restored.max(axis=1), 0.95), 1.0, rtol=1e-6)


def test_ground_that_is_dark_in_two_channels_does_not_make_lamps_weaker() -> None:
    grey = nodes(0.15, 0.2, far=4.0)
    colour = np.array([1.0, 0.5, 0.25])
    tinted = replace(grey, light=colour * grey.light, bright=colour * grey.bright)
    assert told(tinted).power == pytest.approx(told(grey).power, rel=0.1)


@pytest.mark.parametrize(("daylight", "veil"), [(0.25, 1.0), (0.8, 0.3)])
def test_attenuation_is_told_whatever_the_share_of_daylight(daylight: float, veil: float) -> None:
    """The share is between those that the posterior begins with, too."""
    lighting = replace(LIGHTING, model="both")
    scores = []
    for seed in range(2):
        shown = nodes(0.15, 0.2, seed=seed, daylight=daylight, veil=veil)
        posterior = infer([shown], lighting, CLEAR_WATER, ALL)
        assert posterior is not None
        deviation = np.sqrt(np.diag(posterior.covariance))
        assert (deviation < 0.7).all()
        scores.append((posterior.log_attenuation - np.log(CLEAR_WATER + 0.15)) / deviation)
        assert (posterior.levels(np.exp(posterior.log_attenuation)).daylight > 0.0).all()
    assert np.abs(scores).max() < 3.0
    assert np.sqrt(np.mean(np.square(scores))) < 1.5


def test_hidden_differences_tell_scattered_light_of_an_unusual_amount() -> None:
    # Strips of ground are hidden by e^3 times the usual scattered light; as in a survey, nodes
    # count for a thirtieth of themselves.
    place, amount = np.argwhere(np.ones((16, 20), bool)), 3.0
    water = np.repeat(np.where(place[:, :1] % 4 < 2, -2.0, -5.0), 3, axis=1)
    logs, changes = np.zeros((2, 1, len(place), 3)), np.zeros((2, 1, len(place), 3, 9))
    logs[1, 0], changes[1, ..., 3:6] = water, np.eye(3)
    details = details_of([place])
    for seed in range(3):
        ground = 0.5 * np.random.default_rng(seed).standard_normal((len(place), 1))
        p = np.zeros(9)
        fit(np.logaddexp(ground, water + amount), np.full(water.shape, 1e-6), logs, changes,
            details, FITTED._replace(evidence=0.03), p,
            np.repeat([0.1 + 0.01 * np.eye(3)], details.level.max() + 1, axis=0))
        # What was expected, 0, still counts.
        assert (np.abs(p[3:6] - amount) < 0.65 * amount).all()


def test_one_range_leaves_what_was_expected() -> None:
    posterior = found(nodes(0.4, 0.2, near=2.0, far=2.02))
    assert math.sqrt(posterior.covariance[2, 2]) > 0.35


def test_clearest_is_the_distance_of_the_clearest_channel_seen() -> None:
    shown = nodes(0.15, 0.2)
    low, middle, high = found(shown).clearest
    assert low < middle < high
    assert middle == pytest.approx(-found(shown).log_attenuation.min(), abs=0.05)
    without = infer([shown], LIGHTING, CLEAR_WATER, np.array([True, False, False]))
    assert without is not None
    assert without.clearest[1] == pytest.approx(-without.log_attenuation[0], abs=0.05)


def test_frames_of_one_range_each_tell_together() -> None:
    ranges = (1.5, 1.8, 2.2, 2.7, 3.3, 4.0)
    frames = [
        nodes(0.15, 0.1, near=d, far=1.01 * d, seed=i).every(2) for i, d in enumerate(ranges)]
    together, alone = found(*frames), found(frames[0])
    assert together.covariance[2, 2] < 0.7 * alone.covariance[2, 2]
    off = together.log_attenuation - np.log(CLEAR_WATER + 0.15)
    assert (np.abs(off) < 3.0 * np.sqrt(np.diag(together.covariance))).all()


def test_too_few_nodes_tell_nothing() -> None:
    few = nodes(0.15).every(8)
    assert infer([few], LIGHTING, CLEAR_WATER, ALL) is None


@pytest.mark.parametrize("changed", [{"light": 1e300}, {"light": 1e-300}, {"variance": 1e200}])
def test_what_is_beyond_all_bounds_is_no_estimate_and_no_error(changed: dict) -> None:
    shown = nodes(0.15)
    wild = replace(shown, **{
        name: np.where(np.arange(3) > 0, value, getattr(shown, name))
        for name, value in changed.items()})
    posterior = infer([wild], LIGHTING, CLEAR_WATER, ALL)
    assert posterior is None or np.isfinite(posterior.log_attenuation).all()


def test_the_same_nodes_give_the_same_bits() -> None:
    shown = nodes(0.2, 0.3)
    np.testing.assert_array_equal(found(shown).log_attenuation, found(shown).log_attenuation)
