# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Veil that changes over the image: pixels levelled by the gradient of open water."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.images.view import ColourSamples
from uw_visibility.optics.transfer import from_linear, linear_table
from uw_visibility.water.daylight.veil_gradient import VeilGradient, fit_gradient, level_samples

SHAPE = (60, 80)
ROWS, COLUMNS = np.meshgrid(
    (np.arange(SHAPE[0]) + 0.5) / SHAPE[0], (np.arange(SHAPE[1]) + 0.5) / SHAPE[1], indexing="ij")
PLACES = np.stack((ROWS, COLUMNS), axis=-1)
GRADIENT = VeilGradient(
    np.array(((-0.5, 0.1), (-0.3, 0.0), (0.2, -0.2))), np.array((0.25, 0.5)))
VEIL = np.array((0.2, 0.4, 0.6))


@pytest.mark.parametrize(("transfer", "dtype"), [
    ("linear", np.uint8), ("srgb", np.uint8), ("linear", np.uint16), ("srgb", np.uint16),
])
class TestLevelSamples:
    def levelled(self, irradiance, transfer, dtype):
        pixels = from_linear(irradiance, transfer, dtype)
        level = level_samples(ColourSamples(pixels, transfer, np.zeros(3)), GRADIENT).pixels
        assert level.dtype == dtype
        return pixels, level

    def test_open_water_becomes_even(self, transfer, dtype):
        seen = VEIL * np.moveaxis(GRADIENT.at(PLACES), 0, -1)
        _, level = self.levelled(seen, transfer, dtype)
        expected = from_linear(VEIL, transfer, dtype).astype(int)
        # Rounded twice, and once divided by as little as 0.5.
        assert np.abs(level - expected).max() <= 2

    def test_black_and_saturated_pixels_stay_so(self, transfer, dtype):
        irradiance = np.zeros((*SHAPE, 3))
        irradiance[:, 40:] = 1.0
        pixels, level = self.levelled(irradiance, transfer, dtype)
        np.testing.assert_array_equal(level, pixels)

    def test_what_the_veil_is_brighter_before_becomes_darker(self, transfer, dtype):
        pixels, level = self.levelled(np.full((*SHAPE, 3), 0.3), transfer, dtype)
        factor = np.moveaxis(GRADIENT.at(PLACES), 0, -1)
        assert (level[factor > 1.05] < pixels[factor > 1.05]).all()
        assert (level[factor < 0.95] > pixels[factor < 0.95]).all()
        table = linear_table(transfer, dtype)
        np.testing.assert_allclose(table[level] * factor, 0.3, atol=0.02)


class TestFitGradient:
    def of_rows(self, rows: int) -> np.ndarray:
        """Slopes downwards that an area of so many of the image's rows shows."""
        place = PLACES[:rows].reshape(-1, 2)
        light = VEIL * GRADIENT.at(place).T
        return fit_gradient(light, place, np.full(len(place), 1.0 / len(place))).slope[:, 0]

    def test_large_areas_tell_all_of_it(self):
        place = PLACES.reshape(-1, 2)
        fitted = fit_gradient(VEIL * GRADIENT.at(place).T, place, np.full(len(place), 1 / 4800))
        # Relative to the middle of the area instead of the gradient's own place.
        expected = GRADIENT.slope / GRADIENT.at(np.array((0.5, 0.5)))[:, np.newaxis]
        np.testing.assert_allclose(fitted.slope, expected, rtol=0.02, atol=0.003)

    def test_a_strip_tells_little(self):
        assert np.abs(self.of_rows(1)).max() < 0.01
        assert 0.2 < (self.of_rows(3) / self.of_rows(30))[0] < 0.9
