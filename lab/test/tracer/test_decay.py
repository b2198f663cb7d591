# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fits of the truth on arrays whose decay is known."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.tracer.files import (
    fit_decay,
    open_water,
    range_bins,
    scene_light,
    transmissions,
)

BETA = np.array([0.4, 0.15, 0.1])
VEIL = np.array([0.1, 0.4, 0.5])
BOUNCE = np.array([0.05, 0.2, 0.3])


def view(noise: float = 0.0, open_rows: int = 0, bounce: float = 1.0) -> tuple[np.ndarray, ...]:
    """Return image, veil, surface, ranges of a tilted plane; the floor adds to the veil."""
    random = np.random.default_rng(9)
    ranges = np.broadcast_to(np.linspace(8.0, 1.0, 120)[:, None], (120, 160)).copy()
    surface = random.uniform(0.1, 0.9, (120, 160, 1)) * np.ones(3)
    d = ranges[..., None]
    black = VEIL * (1.0 - np.exp(-0.12 * d))
    floor = bounce * BOUNCE * (1.0 - np.exp(-0.3 * d))
    image = surface * np.exp(-BETA * d) + black + floor
    image += noise * random.normal(size=image.shape)
    if open_rows:
        ranges[:open_rows] = np.nan
        image[:open_rows] = VEIL + BOUNCE
    return image, black, surface, ranges


def test_without_light_of_the_floor_the_attenuation_is_that_of_the_water() -> None:
    attenuation, _ = fit_decay(*transmissions(*view(bounce=0.0)))
    assert attenuation == pytest.approx(BETA, rel=0.001)


def test_all_light_that_surfaces_add_falls_more_slowly() -> None:
    attenuation, _ = fit_decay(*transmissions(*view()))
    assert (attenuation < 0.8 * BETA).all()


def test_noise_is_in_the_deviation() -> None:
    _, exact = fit_decay(*transmissions(*view(0.01, bounce=0.0)))
    attenuation, stddev = fit_decay(*transmissions(*view(0.1, bounce=0.0)))
    assert (stddev > 2.0 * exact).all()
    assert (np.abs(attenuation - BETA) < 4.0 * stddev).all()


def test_light_below_its_noise_tells_no_attenuation() -> None:
    middles = np.linspace(1.0, 8.0, 10)
    values = np.full((10, 3), 1e-4)
    attenuation, stddev = fit_decay(middles, values, np.full((10, 3), 1e-3))
    assert np.isnan([attenuation, stddev]).all()


def test_open_water_is_the_veil() -> None:
    image, _, _, ranges = view(open_rows=10)
    assert open_water(image, ranges) == pytest.approx(VEIL + BOUNCE)
    image, _, _, ranges = view()
    assert np.isnan(open_water(image, ranges)).all()


def test_the_light_is_radiance_over_reflectance() -> None:
    reflectance = np.random.default_rng(1).uniform(0.1, 0.5, (20, 20, 3))
    ranges = np.ones((20, 20))
    light = scene_light(reflectance * [0.2, 0.7, 0.9], reflectance, ranges)
    assert light == pytest.approx([0.2, 0.7, 0.9])


def test_bins_hold_every_pixel_with_a_range_once() -> None:
    ranges = np.random.default_rng(2).uniform(1.0, 9.0, (60, 80))
    ranges[:5] = np.nan
    together = np.concatenate(range_bins(ranges))
    assert len(together) == len(set(together.tolist())) == 55 * 80


def test_a_view_without_ranges_is_refused() -> None:
    image, black, surface, ranges = view()
    with pytest.raises(InputError, match="too few pixels"):
        transmissions(image, black, surface, np.full_like(ranges, np.nan))
