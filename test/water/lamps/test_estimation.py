# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Attenuation and scattering under lamps, against a quadrature of its own."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
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
    clearest = int(np.argmin(shown.attenuation))
    assert abs(error[clearest]) < max(0.2 * shown.attenuation[clearest], 0.025)
    assert (found.attenuation_stddev < 0.4 * shown.attenuation).all()


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


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_neither_noise_nor_ground_that_falls_away_biases_attenuation(noise: float) -> None:
    errors = []
    for seed in range(3):
        shown = render(0.15, seed=seed, noise=noise)
        errors.append(estimate(shown).attenuation - shown.attenuation)
    assert (np.abs(np.mean(errors, axis=0)[1:]) < 0.025).all()


@pytest.mark.parametrize(("noise", "most"), [(5e-4, 0.025), (1e-3, 0.01)])
def test_rounding_to_8_bits_of_little_noise_does_not_bias_attenuation(
    noise: float, most: float
) -> None:
    # Red of the far ground is a few codes, with a noise of an eighth and a quarter of one.
    changes = []
    for seed in range(3):
        shown = render(0.15, seed=seed, noise=noise)
        rounded = np.round(shown.image / 257.0).astype(np.uint8)
        found = estimator().estimate_view(View.of(rounded), shown.range)
        changes.append(found.attenuation - estimate(shown).attenuation)
    assert (np.abs(np.mean(changes, axis=0)) < most).all()


def test_lamps_that_are_elsewhere_are_in_sigma() -> None:
    shown = scene(0.15)
    off = [(np.add(place, (0.05, -0.03, 0.05)), axis, beam) for place, axis, beam in LAMPS]
    moved = parameters([(tuple(map(float, place)), axis, beam) for place, axis, beam in off])
    wide = estimate(shown, **moved, **{"lighting.position_stddev": 0.05})
    assert (np.abs(wide.attenuation - shown.attenuation) < 3 * wide.attenuation_stddev).all()
    sure = estimate(shown, **{
        "lighting.position_stddev": 0.0, "lighting.direction_stddev": 0.0})
    assert (sure.attenuation_stddev < wide.attenuation_stddev).all()


@pytest.mark.parametrize("daylight", [0.02, 0.05, 0.15])
@pytest.mark.parametrize("seed", [0, 1])
def test_daylight_beside_the_lamps_is_told_apart(daylight: float, seed: int) -> None:
    shown = scene(0.15, seed, daylight)
    found = estimate(shown, **{"lighting.model": "both"})
    assert found.status is Status.OK
    error = found.attenuation - shown.attenuation
    assert (np.abs(error) < 3 * found.attenuation_stddev).all()
    # Contrast looks much the same without daylight, in far clearer water.
    assert (np.abs(error) < 0.5 * shown.attenuation).all()
    assert found.lamps is not None
    # Light of day over that of a lamp at 1 m, by exposure and reflectance of white alike.
    share = found.lamps.daylight / found.lamps.power
    assert (share > daylight).all() and (share < 10 * np.pi * daylight).all()


def test_one_range_alone_tells_nothing() -> None:
    flat = render(0.15, distance=np.full(SIZE, 2.0))
    found = estimate(flat)
    assert not np.isfinite(found.attenuation).any()
    assert found.status is Status.RANGE_SPREAD_TOO_SMALL


@pytest.mark.parametrize("seed", [16, 21])
def test_clear_water_is_not_told_where_one_frame_cannot_tell(seed: int) -> None:
    # By contrast alone these frames are of water clearer than clear water, ± 0.3 1/m; that it
    # is not, tells no attenuation: it was said to be a tenth of what it is, ± 0.06.
    rows = np.linspace(-0.3, 0.3, SIZE[0])[:, np.newaxis]
    tilted = render(0.3, seed=seed, distance=1.8 + rows + np.zeros(SIZE), noise=1e-3)
    found = estimate(tilted)
    assert found.status is Status.RANGE_SPREAD_TOO_SMALL
    assert not np.isfinite(found.attenuation[1:]).any()


def test_darkness_and_glare_are_refused() -> None:
    shown = scene(0.15)
    for image, reason in (
        (np.zeros_like(shown.image), Status.TOO_DARK),
        (np.full_like(shown.image, 65535), Status.SATURATED),
        (shown.image[..., 0], Status.NO_COLOUR),
    ):
        found = estimator().estimate_view(View.of(np.ascontiguousarray(image)), shown.range)
        assert found.status is reason


def test_what_seems_clearer_than_clear_water_is_not_sure_to_be_clear() -> None:
    """A filter over frames believes whoever is sure."""
    shown = scene(0.05)
    even = cv2.GaussianBlur(shown.image, (0, 0), 6.0).astype(np.float64)
    # Texture that grows with range hides how it fades.
    growth = np.clip(shown.range / np.median(shown.range), 0.3, 2.0)[..., np.newaxis] ** 1.4
    most = np.iinfo(shown.image.dtype).max - 1
    image = np.clip(np.round(even + growth * (shown.image - even)), 0, most)
    found = estimator().estimate_view(View.of(image.astype(shown.image.dtype)), shown.range)
    # The water is more turbid by 0.05 1/m.
    assert found.attenuation == pytest.approx(CLEAR_WATER, abs=0.015)
    assert (found.attenuation_stddev > 0.3 * 0.02).all()
