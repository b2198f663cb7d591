# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Radiance recovery under lamps: even light, whatever the place, and bounded gain."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from lamp_scene import CLEAR_WATER, RIG, SIZE, LampScene, parameters, render
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig, PipelineConfig
from uw_visibility.enhancement.lamp_radiance import LampRestorer
from uw_visibility.optics.lamps import LEFT_EYE, LightField, tabulate

ALPHA = 0.15


@functools.cache
def shown() -> LampScene:
    """A scene without noise; not to be changed."""
    return render(ALPHA, noise=0.0)


def field_of(scale: float, scattering: float) -> LightField:
    lamps = tuple(PipelineConfig.from_parameters(parameters()).lighting.lamps())
    tables = tabulate(RIG.rays_at, SIZE, lamps, LEFT_EYE)
    none = np.zeros(3)
    return tables.field(
        CLEAR_WATER + ALPHA, np.full(3, scale), np.full(3, scattering), none, none)


SURE = np.ones(SIZE, np.float32)


def restored(
    image: NDArray[Any], ranges: NDArray[np.float32], known: NDArray[np.float32] = SURE,
    **config: float,
) -> Any:
    scale = float(shown().direct.max() / render(ALPHA, noise=0.0, exposure=1.0).direct.max())
    field = field_of(scale, np.pi * 0.7 * ALPHA * scale)
    limits = EnhancementConfig(**{"max_gain": 1000.0, "max_noise": 10.0} | config)
    restorer = LampRestorer(limits, "linear", Workers(1))
    return restorer.restore(image, ranges, field, np.full(3, 0.5), known)


def test_reflectance_comes_back_wherever_it_is_and_however_far() -> None:
    image, limited = restored(shown().image, shown().range)
    clear = ~limited & (shown().range < 6.0)
    assert clear.mean() > 0.4
    error = image[clear] / 65535 - shown().reflectance[clear]
    assert np.abs(error).max() < 0.06
    assert np.sqrt(np.mean(error**2)) < 0.015


def test_gain_is_limited_by_noise_and_what_is_dark_fades_without_colour() -> None:
    image, limited = restored(shown().image, shown().range, max_gain=8.0)
    open_water, beyond = restored(
        np.full((*SIZE, 3), 40, np.uint16), np.full(SIZE, np.inf, np.float32), max_noise=0.05)
    assert limited[0].all()
    assert not limited[-20:, 90:110].any()
    # Less gain than is needed: darker than it is, but no brighter.
    darker = image[limited] / 65535 - shown().reflectance[limited]
    assert darker.max() < 0.06
    assert beyond.all()
    assert open_water.max() < 0.1 * 65535


def test_what_has_no_reliable_range_keeps_its_light() -> None:
    known = SURE.copy()
    known[:, :60], known[:, 60:90] = 0.0, 0.5
    whole, _ = restored(shown().image, shown().range)
    image, limited = restored(shown().image, shown().range, known)
    np.testing.assert_allclose(image[:, :60], shown().image[:, :60], atol=1)
    np.testing.assert_array_equal(image[:, 90:], whole[:, 90:])
    middle = 0.5 * (shown().image[:, 60:90].astype(float) + whole[:, 60:90])
    np.testing.assert_allclose(image[:, 60:90], middle, atol=2)
    assert limited[:, :60].all()
    assert not limited[-20:, 90:110].any()


def test_noise_of_dark_water_is_not_lifted() -> None:
    rng = np.random.default_rng(0)
    image = np.rint(rng.normal(20.0, 1.5, (*SIZE, 3))).astype(np.uint8)
    restorer = LampRestorer(
        EnhancementConfig(max_gain=50.0, max_noise=10.0), "linear", Workers(1))
    ranges = np.full(SIZE, 1.0, np.float32)
    # Of a part that has about the same light.
    told, plain = (
        restorer.restore(
            image, ranges, field_of(0.2, 0.0), np.full(3, noise), SURE)[0][60:80, 90:110]
        for noise in (1.5, 0.0))
    assert np.abs(told.mean(axis=(0, 1)) - plain.mean(axis=(0, 1))).max() < 1.0
    assert (plain.std(axis=(0, 1)) > 5.0 * 1.5).all()
    assert (told.std(axis=(0, 1)) < 0.5 * plain.std(axis=(0, 1))).all()


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_unknown_channels_stay_and_others_do_not(kind: Any) -> None:
    image = (shown().image // (257 if kind is np.uint8 else 1)).astype(kind)
    field = field_of(1.0, 0.0)
    log_direct = field.log_direct.copy()
    log_direct[0] = np.nan
    restorer = LampRestorer(EnhancementConfig(), "linear", Workers(1))
    out, _ = restorer.restore(
        image, shown().range, field._replace(log_direct=log_direct), np.full(3, 0.5), SURE)
    assert out.dtype == kind
    np.testing.assert_array_equal(out[..., 0], image[..., 0])
    assert (out[..., 1] != image[..., 1]).any()
