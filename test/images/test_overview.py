# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Overview of a frame: three pictures in a row."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.images.overview import colour_ends, overview, viridis


@pytest.mark.parametrize("dtype, top", [(np.uint8, 1), (np.uint16, 256)])
@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 3)])
def test_it_shows_before_after_and_what_matched(
    shape: tuple[int, ...], dtype: type, top: int
) -> None:
    before, after = np.full(shape, 50 * top, dtype), np.full(shape, 200 * top, dtype)
    ranges = 1.0 / np.tile(np.linspace(0.2, 0.5, 30, dtype=np.float32), (20, 1))
    ranges[:4] = np.nan
    whole = overview(before, after, ranges, "light", 0.0)
    assert (whole.shape, whole.dtype) == ((20 + 3 * 16, 90, 3), np.uint8)
    shown = whole[16:36]
    assert (shown[:, :30] == 50).all()
    assert (shown[:, 30:60] == 200).all()
    drawn = shown[:, 60:].astype(int)
    assert (drawn[:4] == 0).all()
    # Far is dark and near is light, over all that the colours have.
    lightness = drawn[10].sum(axis=1)
    assert lightness[0] == viridis(np.zeros((1, 1))).astype(int).sum()
    assert lightness[-1] == viridis(np.ones((1, 1))).astype(int).sum()
    assert lightness[-1] > lightness[15] > lightness[0]


def test_where_nothing_matched_it_is_black() -> None:
    image = np.full((8, 9, 3), 7, np.uint8)
    whole = overview(image, image, np.full((8, 9), np.nan, np.float32), "", 0.0)
    assert (whole[16:24, 18:] == 0).all()


def test_labels_scale_and_assumptions_are_written() -> None:
    image = np.full((240, 320, 3), 90, np.uint8)
    ranges = np.tile(np.linspace(1.0, 9.0, 320, dtype=np.float32), (240, 1))
    other = overview(image, image, 2.0 * ranges, "transfer srgb", 0.0)
    assumed = overview(image, image, ranges, "transfer linear (assumed)", 0.0)
    above, below = assumed[:16], assumed[256:]
    assert all(above[:, x : x + 320].any() for x in (0, 320, 640))
    # Twice the range has the same colours, but other numbers beside the same bar.
    np.testing.assert_array_equal(assumed[16:256], other[16:256])
    np.testing.assert_array_equal(below[:16, 640:], other[256:272, 640:])
    assert (below[16:, 640:] != other[272:, 640:]).any()
    assert (below[:, :640] != other[256:, :640]).any()
    assert overview(image, image, ranges, "word " * 300, 0.0).shape[0] > assumed.shape[0]


def test_the_scale_of_a_clear_sea_has_no_exponents(monkeypatch: pytest.MonkeyPatch) -> None:
    words: list[str] = []
    monkeypatch.setattr(
        "uw_visibility.images.overview._write", lambda strip, text, *place: words.append(text))
    image = np.zeros((240, 320, 3), np.uint8)
    overview(image, image, np.linspace(0.5, 120.0, 76800, dtype=np.float32).reshape(240, 320),
             "", 0.0)
    assert words[-3:] == ["over 120 m", "3.3 m", "1.7 m"]


@pytest.mark.parametrize("width, labels", [
    (320, ["over 10 m", "1.8 m", "1 m"]), (130, ["over 10 m", "1 m"]), (60, ["over 10 m"])])
def test_values_of_the_scale_do_not_overlap(
    monkeypatch: pytest.MonkeyPatch, width: int, labels: list[str]
) -> None:
    words: list[str] = []
    monkeypatch.setattr(
        "uw_visibility.images.overview._write", lambda strip, text, *place: words.append(text))
    image = np.zeros((40, width, 3), np.uint8)
    ranges = np.where(np.arange(width) < width // 2, 10.0, 1.0).astype(np.float32)
    overview(image, image, np.tile(ranges, (40, 1)), "", 0.0)
    assert words[3:] == labels


def test_an_image_that_was_not_restored_is_not_said_to_be() -> None:
    image, ranges = np.full((240, 320, 3), 90, np.uint8), np.ones((240, 320), np.float32)
    alike = overview(image, image, ranges, "", 0.0)
    restored = overview(image, image + np.uint8(1), ranges, "", 0.0)
    assert (alike[:16, 320:640] != restored[:16, 320:640]).any()
    np.testing.assert_array_equal(alike[:16, :320], restored[:16, :320])


def test_the_scale_ends_where_errors_of_range_are_half_of_it() -> None:
    """A disparity of a tenth of a pixel is open water, not something at 600 m."""
    error = 0.01
    ranges = np.append(np.linspace(2.0, 20.0, 97), [600.0, 50.0, 1e4])
    near, far = colour_ends(1.0 / ranges.astype(np.float32), error)[::-1]
    assert 1.0 / far == pytest.approx(50.0)
    assert 1.0 / near == pytest.approx(2.0, rel=0.1)
    low, high = colour_ends(np.full(100, 1e-4, np.float32), error)
    assert low == high == 2.0 * error


def test_words_grow_with_the_picture() -> None:
    """A wide picture is shown smaller: of a camera's 1280 px, titles of 11 px cannot be read."""
    heights = []
    for width in (480, 1440):
        image = np.full((30, width, 3), 90, np.uint8)
        ranges = np.tile(np.linspace(1.0, 9.0, width, dtype=np.float32), (30, 1))
        heights.append(overview(image, image, ranges, "word " * 40, 0.0).shape[0] - 30)
    assert heights[1] == 3 * heights[0]
