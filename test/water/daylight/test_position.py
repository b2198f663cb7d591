# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Halves of an image that show different water at equal range."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.status import Status
from uw_visibility.water.daylight.position import HalfEnvelopes, compare_halves

RANGE = np.geomspace(1.5, 14.0, 12)
ATTENUATION = np.array([0.35, 0.2, 0.15])
VEIL = np.array([0.4, 0.6, 0.7])
LEFT_RIGHT, TOP_BOTTOM, MIDDLE_SURROUNDINGS = range(3)


def halves(split: int, first: np.ndarray, second: np.ndarray) -> HalfEnvelopes:
    """Halves of one split with the light of dark patches, (3, N); the others are alike."""
    dark = np.tile(VEIL[:, np.newaxis] * (1.0 - np.exp(-ATTENUATION[:, np.newaxis] * RANGE)),
                   (2, 3, 1, 1))
    dark[0, split], dark[1, split] = first, second
    return HalfEnvelopes(
        np.tile(RANGE, (2, 3, 1)), dark, np.full(3, 0.002), np.full((2, 3, len(RANGE), 2), 0.5))


def black(more: float = 0.0) -> np.ndarray:
    """Light of black patches, (3, N), in water with so much more attenuation, 1/m."""
    return VEIL[:, np.newaxis] * (1.0 - np.exp(-(ATTENUATION[:, np.newaxis] + more) * RANGE))


class TestPlume:
    """In the second half, with more attenuation by as much again."""

    def test_its_attenuation_is_found_where_it_is_the_veil_far_off(self):
        found = compare_halves(halves(LEFT_RIGHT, black(), black(0.2)), ATTENUATION, VEIL, VEIL)
        np.testing.assert_allclose(found.difference[LEFT_RIGHT], -0.2, rtol=0.1)
        assert found.significance[LEFT_RIGHT] < -4.0

    def test_wrong_ranges_in_one_half_do_not_hide_it(self):
        dark = black()
        dark[:, -2:] = black()[:, :2]
        thick = black(0.2)
        thick[:, -2:] = black()[:, 1:3]
        found = compare_halves(halves(LEFT_RIGHT, dark, thick), ATTENUATION, VEIL, VEIL)
        np.testing.assert_allclose(found.difference[LEFT_RIGHT], -0.2, rtol=0.15)
        assert found.significance[LEFT_RIGHT] < -4.0

    @pytest.mark.parametrize("more", [0.05, 0.1])
    def test_attenuation_on_average_is_between_both(self, more):
        """The lower envelope of the image is that of its clearest part."""
        found = compare_halves(halves(LEFT_RIGHT, black(), black(more)), ATTENUATION, VEIL, VEIL)
        average, stddev = found.averaged(ATTENUATION)
        np.testing.assert_allclose(average, ATTENUATION + 0.5 * more, atol=0.1 * more)
        assert (stddev > 0.2 * more).all()
        assert (stddev < 0.5 * more).all()

    def test_one_that_is_as_strong_as_the_water_is_refused(self):
        found = compare_halves(halves(LEFT_RIGHT, black(), black(0.2)), ATTENUATION, VEIL, VEIL)
        assert found.refutes(ATTENUATION) is Status.UNEVEN_SIDES


def test_a_layer_that_thickens_downwards_adds_what_halves_differ_by():
    """Halves of what lies at one range differ by half of what its ends do."""
    found = compare_halves(halves(TOP_BOTTOM, black(), black(0.03)), ATTENUATION, VEIL, VEIL)
    average, stddev = found.averaged(ATTENUATION)
    np.testing.assert_allclose(average, ATTENUATION + 0.03, atol=0.01)
    assert (stddev > 0.01).all()


class TestSurroundings:
    def test_a_lens_that_darkens_them_a_little_is_recognised(self):
        found = compare_halves(
            halves(MIDDLE_SURROUNDINGS, black(), 0.94 * black()), ATTENUATION, VEIL, VEIL)
        average, stddev = found.averaged(0.94 * ATTENUATION)
        assert found.refutes(ATTENUATION) is Status.OK
        np.testing.assert_array_less(np.abs(average - ATTENUATION), stddev)
        assert (average > 0.99 * ATTENUATION).all()

    def test_a_lens_that_darkens_them_leaves_the_middle_right(self):
        found = compare_halves(
            halves(MIDDLE_SURROUNDINGS, black(), 0.9 * black()), ATTENUATION, VEIL, VEIL)
        average, _ = found.averaged(0.9 * ATTENUATION)
        assert (average > 0.97 * ATTENUATION).all()
        assert (average < 1.15 * ATTENUATION).all()

    def test_those_that_are_brighter_lack_dark_patches(self):
        found = compare_halves(
            halves(MIDDLE_SURROUNDINGS, black(), 1.1 * black()), ATTENUATION, VEIL, VEIL)
        average, _ = found.averaged(ATTENUATION)
        np.testing.assert_allclose(average, ATTENUATION)


def test_one_water_stays_as_estimated():
    rng = np.random.default_rng(3)
    seen = [black() + 0.03 * rng.random() * VEIL[:, np.newaxis]
            * np.exp(-ATTENUATION[:, np.newaxis] * RANGE) for _ in range(2)]
    found = compare_halves(halves(TOP_BOTTOM, *seen), ATTENUATION, VEIL, VEIL)
    average, stddev = found.averaged(ATTENUATION)
    np.testing.assert_allclose(average, ATTENUATION, rtol=0.02)
    assert (stddev < 0.03 * ATTENUATION).all()
    assert found.refutes(ATTENUATION) is Status.OK
