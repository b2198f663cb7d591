# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Metrics against published values and closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uw_visibility_lab.evaluation import metrics

# L*a*b* of sRGB's primaries and greys under D65, as printed by Lindbloom's calculator
# (http://www.brucelindbloom.com) and in the literature, to two decimals.
PUBLISHED = [
    ((255, 255, 255), (100.0, 0.0, 0.0)),
    ((0, 0, 0), (0.0, 0.0, 0.0)),
    ((255, 0, 0), (53.24, 80.09, 67.20)),
    ((0, 255, 0), (87.73, -86.18, 83.18)),
    ((0, 0, 255), (32.30, 79.19, -107.86)),
    ((255, 255, 0), (97.14, -21.55, 94.48)),
    ((0, 255, 255), (91.11, -48.09, -14.13)),
    ((255, 0, 255), (60.32, 98.23, -60.82)),
    ((128, 128, 128), (53.59, 0.0, 0.0)),
]


@pytest.mark.parametrize(("rgb", "expected"), PUBLISHED)
def test_lab_of_published_colours(
    rgb: tuple[int, int, int], expected: tuple[float, float, float]
) -> None:
    found = metrics.lab(np.array([[rgb]], np.uint8))
    np.testing.assert_allclose(found, [[expected]], atol=0.06)


def test_numbers_that_are_no_codes_are_linear() -> None:
    # Linear 0.18 is the photographic mid grey: L* = 49.5.
    found = metrics.lab(np.full((1, 1, 3), 0.18, np.float32))
    assert found[0, 0, 0] == pytest.approx(49.50, abs=0.01)


def test_colour_difference_is_the_distance_in_lab() -> None:
    first = np.array([[[255, 255, 255], [255, 0, 0]]], np.uint8)
    second = np.array([[[0, 0, 0], [0, 255, 0]]], np.uint8)
    red_green = np.linalg.norm(np.subtract(PUBLISHED[2][1], PUBLISHED[3][1]))
    found = metrics.colour_difference(first, second)
    np.testing.assert_allclose(found, [[100, red_green]], atol=0.1)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 255), min_size=6, max_size=6))
def test_colour_difference_is_symmetric_and_zero_for_the_same(values: list[int]) -> None:
    first, second = np.array(values, np.uint8).reshape(2, 1, 1, 3)
    forth = metrics.colour_difference(first, second)
    np.testing.assert_allclose(forth, metrics.colour_difference(second, first))
    assert metrics.colour_difference(first, first).item() == 0
    assert forth.item() > 0 or values[:3] == values[3:]


def test_disparity_fractions() -> None:
    nan = np.nan
    truth = np.array([[10, 10, 10, 10, nan]], np.float32)
    found = np.array([[10, 11, 12.5, nan, 3]], np.float32)
    assert metrics.correct_fraction(found, truth) == 0.5
    assert metrics.correct_fraction(found, truth, 2.5) == 0.75
    assert metrics.bad_fraction(found, truth) == pytest.approx(1 / 3)
    assert metrics.matched_fraction(found) == pytest.approx(0.8)
    nothing = np.full((1, 5), nan, np.float32)
    assert metrics.correct_fraction(nothing, truth) == 0
    assert np.isnan(metrics.bad_fraction(nothing, truth))
    assert np.isnan(metrics.correct_fraction(found, nothing))
