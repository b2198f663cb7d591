# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Attenuation and scattering under lamps, against a quadrature of its own."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from lamp_scene import (
    CLEAR_WATER,
    LAMPS,
    RIG,
    SIZE,
    LampScene,
    parameters,
    render,
)

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.view import View
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.lamps.estimation import LampEstimator
from uw_visibility.water.lamps.posterior import infer


def estimator(**changed: Any) -> LampEstimator:
    config = PipelineConfig.from_parameters(parameters() | changed)
    return LampEstimator(config.water, config.lighting, CLEAR_WATER, RIG.rays_at)


@lru_cache
def scene(alpha: float, seed: int = 0, daylight: float = 0.0) -> LampScene:
    return render(alpha, seed=seed, daylight=daylight)


def estimate(shown: LampScene, **changed: Any) -> WaterEstimate:
    return estimator(**changed).estimate_view(View.of(shown.image), shown.range)


@pytest.mark.parametrize("alpha", [0.05, 0.15, 0.3])
def test_attenuation_is_that_of_the_water_within_sigma(alpha: float) -> None:
    shown = scene(alpha)
    found = estimate(shown)
    assert found.status is Status.OK
    error = found.attenuation - shown.attenuation
    assert (np.abs(error) < 3 * found.attenuation_stddev).all()
    assert (np.abs(error) < 0.35 * shown.attenuation).all()
    assert (found.attenuation_stddev < 0.4 * shown.attenuation).all()
    # The visibility distance is given as an interval, which is not symmetric.
    assert found.clearest is not None
    low, middle, high = found.clearest
    truth = -np.log(shown.attenuation.min())
    assert middle - 2.5 * (middle - low) < truth < middle + 2.5 * (high - middle)


def test_the_interval_of_the_distance_has_the_error_of_the_model_too() -> None:
    shown = scene(0.15)
    found, config = estimate(shown), PipelineConfig.from_parameters(parameters())
    assert found.clearest is not None
    assert found.lamps is not None
    assert found.lamps.nodes is not None
    alone = infer([found.lamps.nodes], config.lighting, CLEAR_WATER, np.ones(3, np.bool_))
    assert alone is not None
    # 7 % of the attenuation, of which the distance is the inverse.
    np.testing.assert_allclose(
        np.diff(found.clearest)**2 - np.diff(alone.clearest)**2, 0.07**2, rtol=1e-6)
    assert found.clearest[1] == alone.clearest[1]


def test_patches_that_differ_more_than_any_ground_tell_no_water() -> None:
    """As where the lamps are elsewhere, or light scattered in turbid water hides the ground."""
    shown = scene(0.15)
    patches = 8 * np.random.default_rng(0).standard_normal((18, 26, 1)).cumsum(axis=0).cumsum(1) / 9
    factor = np.exp(np.clip(patches, -3.0, 3.0)).repeat(8, axis=0).repeat(8, axis=1)
    image = np.clip(0.05 * factor * shown.image, 0, 65535).astype(np.uint16)
    found = estimator().estimate_view(View.of(image), shown.range)
    assert found.status is Status.NOT_ONE_WATER
    assert np.isnan(found.attenuation).all()


@pytest.mark.parametrize("alpha", [0.15, 0.3])
def test_scattered_and_direct_light_are_those_of_the_quadrature(alpha: float) -> None:
    shown = scene(alpha)
    reader = estimator()
    light = reader.estimate_view(View.of(shown.image), shown.range).lamps
    assert light is not None
    field = reader.tables(SIZE).field(
        light.attenuation, light.power, light.scattering, light.daylight, light.veil)
    rows, columns = (np.round(each).astype(int) for each in (field.rows, field.columns))
    # Far along every node's ray nothing but water is seen.
    far = render(alpha, seed=0, distance=np.full(SIZE, 24.9), exposure=1.0).scattered
    scale = (shown.scattered / render(alpha, seed=0, exposure=1.0).scattered)[0, 0, 0]
    ratio = field.scattered[..., -1].transpose(1, 2, 0) / (scale * far[np.ix_(rows, columns)])
    assert np.quantile(np.abs(ratio - 1), 0.9) < 0.15


def test_noise_makes_attenuation_less_sure_and_not_wrong() -> None:
    for seed in range(3):
        shown = render(0.15, seed=seed, noise=1e-2)
        noisy, clean = estimate(shown), estimate(render(0.15, seed=seed, noise=1e-4))
        error = np.abs(noisy.attenuation - shown.attenuation)
        assert (error < 2.5 * noisy.attenuation_stddev).all()
        assert (noisy.attenuation_stddev / noisy.attenuation
                > clean.attenuation_stddev / clean.attenuation).all()


@pytest.mark.parametrize("noise", [5e-4, 1e-3])
def test_rounding_to_8_bits_of_little_noise_is_within_sigma(noise: float) -> None:
    # Red of the far ground is a few codes, with a noise of an eighth and a quarter of one.
    for seed in range(3):
        shown = render(0.15, seed=seed, noise=noise)
        rounded = np.round(shown.image / 257.0).astype(np.uint8)
        found = estimator().estimate_view(View.of(rounded), shown.range)
        error = np.abs(found.attenuation - shown.attenuation)
        assert (error < 2.5 * found.attenuation_stddev).all()
        assert (error < 0.5 * shown.attenuation).all()


def test_lamps_that_are_elsewhere_are_in_sigma() -> None:
    shown = scene(0.15)
    off = [(np.add(place, (0.05, -0.03, 0.05)), axis, beam) for place, axis, beam in LAMPS]
    moved = parameters([(tuple(map(float, place)), axis, beam) for place, axis, beam in off])
    wide = estimate(shown, **moved, **{"lighting.position_stddev": 0.05})
    assert (np.abs(wide.attenuation - shown.attenuation) < 3 * wide.attenuation_stddev).all()


@pytest.mark.parametrize(("daylight", "seed"), [(0.02, 0), (0.05, 1), (0.15, 0)])
def test_daylight_beside_the_lamps_is_told_apart(daylight: float, seed: int) -> None:
    shown = scene(0.15, seed, daylight)
    found = estimate(shown, **{"lighting.model": "both"})
    assert found.status is Status.OK
    error = found.attenuation - shown.attenuation
    assert (np.abs(error) < 3 * found.attenuation_stddev).all()
    # Light falls much the same without daylight, in water that is ten times clearer.
    assert (np.abs(error) < shown.attenuation).all()
    assert found.lamps is not None
    # Light of day over that of a lamp at 1 m, by exposure and reflectance of white alike.
    share = found.lamps.daylight / found.lamps.power
    if daylight < 0.1:
        # Beyond, the lamps give a twentieth of the light, and their power is not told.
        assert (np.abs(np.log(share / (np.pi * daylight))) < np.log(2.5)).all()
    # Half of it is veil, and what is not told of one is told of the other.
    assert (found.lamps.veil > 0.2 * found.lamps.daylight).all()
    assert (found.lamps.veil < 1.5 * found.lamps.daylight).all()


def test_one_range_alone_tells_nothing() -> None:
    flat = render(0.15, distance=np.full(SIZE, 2.0))
    found = estimate(flat)
    assert not np.isfinite(found.attenuation).any()
    assert found.status is Status.RANGE_SPREAD_TOO_SMALL


@pytest.mark.parametrize("seed", [16, 21])
@pytest.mark.parametrize("alpha", [0.1, 0.3])
def test_clear_water_is_not_told_where_one_frame_cannot_tell(seed: int, alpha: float) -> None:
    # By contrast alone these frames were of water clearer than clear water, ± 0.06 1/m.
    rows = np.linspace(-0.3, 0.3, SIZE[0])[:, np.newaxis]
    tilted = render(alpha, seed=seed, distance=1.8 + rows + np.zeros(SIZE), noise=1e-3)
    found = estimate(tilted)
    assert (np.abs(found.attenuation - tilted.attenuation) < 3.0 * found.attenuation_stddev).all()
    assert (found.attenuation_stddev > 0.15 * found.attenuation).all()


def test_darkness_and_glare_are_refused() -> None:
    shown = scene(0.15)
    for image, reason in (
        (np.zeros_like(shown.image), Status.TOO_DARK),
        (np.full_like(shown.image, 65535), Status.SATURATED),
        (shown.image[..., 0], Status.NO_COLOUR),
    ):
        found = estimator().estimate_view(View.of(np.ascontiguousarray(image)), shown.range)
        assert found.status is reason


def test_ground_that_is_brighter_far_away_does_not_make_the_water_surely_clear() -> None:
    """A filter over frames believes whoever is sure."""
    shown = scene(0.05)
    # By itself, such ground looks like light that hardly falls.
    growth = (shown.range / shown.range.min())[..., np.newaxis] ** 0.5
    direct = np.clip(shown.reflectance * growth, 0.0, 3.0) * shown.direct
    irradiance = direct + shown.scattered
    codes = 0.8 * 65535 * irradiance / np.quantile(irradiance, 0.999)
    found = estimator().estimate_view(
        View.of(np.clip(codes, 0, 65535).astype(np.uint16)), shown.range)
    error = found.attenuation - shown.attenuation
    assert (np.abs(error) < 3.0 * found.attenuation_stddev).all()
