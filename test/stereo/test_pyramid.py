# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Matching at reduced size: the published disparity is that of the full size."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import blurred, codes, in_water, stereo_pair, texture

from uw_visibility import Pipeline, PipelineConfig, StereoRig
from uw_visibility.config.schema import StereoConfig
from uw_visibility.images.view import View
from uw_visibility.stereo.pyramid import Pyramid

FAST = Path(__file__).resolve().parents[2] / "config" / "fast.yaml"
RIG = StereoRig(300.0, 0.1, (160.0, 121.0), (157.5, 121.0))
HEIGHT, WIDTH = 243, 323


def slope() -> np.ndarray:
    """Disparity of a sea floor that rises towards the lower right, px."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return (8.0 + 0.05 * y + 0.012 * x).astype(np.float32)


@pytest.fixture(scope="module")
def pair() -> tuple[np.ndarray, np.ndarray]:
    columns = np.arange(WIDTH)
    # Blurred as by a lens: texture of single pixels would be measured as noise.
    wide = blurred(texture((HEIGHT, WIDTH + 60, 3), 4, (2, 6)), 0.8)
    # The texture is the right camera's view, and what the left one sees is right of it.
    left = np.stack([
        np.stack([np.interp(columns - d + 30, np.arange(WIDTH + 60), c) for c in row.T], -1)
        for row, d in zip(wide, slope(), strict=True)
    ])
    first, second = (
        in_water(view, 30.0 / slope(), [0.5, 0.3, 0.2], [0.7] * 3)
        for view in (left, wide[:, 30:-30])
    )
    return first, second


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_a_slope_comes_back_as_it_was(factor: int) -> None:
    reduction = Pyramid(factor, (HEIGHT, WIDTH))
    height, width = HEIGHT // factor, WIDTH // factor
    if reduction.factor == 1:
        assert (height, width) < (64, 96)
        return
    # A square's disparity is the mean of its pixels', and smaller by the factor.
    whole = slope()[: height * factor, : width * factor]
    small = whole.reshape(height, factor, width, factor).mean(axis=(1, 3)) / factor
    full = reduction.upsample_disparity(small.astype(np.float32))
    assert full.shape == (HEIGHT, WIDTH)
    inside = (slice(factor, height * factor - factor), slice(factor, width * factor - factor))
    np.testing.assert_allclose(full[inside], slope()[inside], atol=2e-4)
    # At the border values are repeated, not interpolated.
    np.testing.assert_allclose(full, slope(), atol=0.05 * (2 * factor + 1))


def test_two_surfaces_are_not_mixed_and_nothing_is_made_up() -> None:
    small = np.full((100, 120), 5.0, np.float32)
    small[:, 60:] = 12.0
    small[40:60] = np.nan
    full = Pyramid(2, (200, 240)).upsample_disparity(small)
    assert set(np.unique(full[np.isfinite(full)])) == {10.0, 24.0}
    assert np.isnan(full[80:120]).all()
    assert np.isfinite(full[:80]).all()
    assert (full[:80, :120] == 10.0).all()


def test_confidence_stays_with_its_disparity_where_squares_are_incomplete() -> None:
    pyramid = Pyramid(4, (483, 643))
    # Neighbours are equal or on two surfaces, so that each pixel has its square's disparity.
    small = 2.0 * np.random.default_rng(0).integers(2, 10, pyramid.small).astype(np.float32)
    small[small < 8.0] = np.nan
    disparity = pyramid.upsample_disparity(small)
    confidence = pyramid.upsample_confidence(np.nan_to_num(small / 80.0), disparity)
    np.testing.assert_allclose(320.0 * confidence, np.nan_to_num(disparity), rtol=1e-6)


@given(st.integers(1, 4), st.floats(0, 300), st.floats(0, 200), st.floats(4, 60))
def test_a_point_has_the_same_range_at_both_sizes(
    factor: int, x: float, y: float, disparity: float
) -> None:
    small = Pyramid(factor, (480, 640)).rig(RIG)
    u, v = (x + 0.5) / factor - 0.5, (y + 0.5) / factor - 0.5
    points = []
    for rig, point, shift in ((RIG, (x, y), disparity), (small, (u, v), disparity / factor)):
        depth = rig.focal_length * rig.baseline / (shift - rig.offset)
        centre = np.array(rig.principal_point)
        points.append([*((np.array(point) - centre) / rig.focal_length * depth), depth])
    np.testing.assert_allclose(points[0], points[1], rtol=1e-6, atol=1e-9)


def test_images_too_small_to_be_matched_smaller_stay() -> None:
    reduction = Pyramid(2, (120, 180))
    image = np.zeros((120, 180, 3), np.uint8)
    assert reduction.downsample(image) is image


def test_the_search_begins_at_the_least_disparity_or_below() -> None:
    config = StereoConfig(min_disparity=5, max_disparity=63)
    found = Pyramid(2, (480, 640)).settings(config)
    assert (found.min_disparity, found.max_disparity) == (2, 31)


def test_the_farthest_surfaces_within_the_limits_are_matched_at_any_scale() -> None:
    """Disparities of 9 to 12 px, of which a search from 12 px finds none."""
    wide = blurred(texture((288, 500, 3), 4, (8, 24)), 3.0)
    left, right = stereo_pair(codes(wide / 255.0), np.repeat((20.0, 10.0, 7.0), 96), 420)
    config = PipelineConfig.from_parameters(
        {"stereo.reduction": 4, "stereo.min_disparity": 9, "stereo.max_disparity": 63})
    found = Pipeline(StereoRig(300.0, 0.1, (209.5, 143.5)), config).process(
        left, right, enhance=()).disparity
    inner = found[:, 60:360]
    for rows, truth in ((np.s_[12:84], 20.0), (np.s_[108:180], 10.0)):
        assert np.isfinite(inner[rows]).mean() > 0.7
        assert abs(np.nanmedian(inner[rows]) - truth) < 0.4
    assert np.nanmin(found) >= 9.0


def test_the_fast_preset_publishes_full_size_and_true_geometry(
    pair: tuple[np.ndarray, np.ndarray],
) -> None:
    whole, fast = (
        Pipeline(RIG, config).process(*pair, match_original=True)
        for config in (PipelineConfig(), PipelineConfig.from_yaml(FAST))
    )
    assert fast.timing_ms["reduction"] > 0
    for result in (whole, fast):
        assert result.stereo.original is not None
        for disparity in (result.disparity, result.stereo.filled, result.stereo.original):
            error = (disparity - slope())[:, 40:]
            assert np.isfinite(error).mean() > 0.8
            assert abs(np.nanmean(error)) < 0.05
            assert np.nanpercentile(np.abs(error), 95) < 0.5
        truth = RIG.range_from_disparity(slope())
        assert np.median(np.abs(result.stereo.filled_range / truth - 1)) < 0.01
    assert fast.stereo.range.shape == whole.stereo.range.shape
    for name in ("left", "right", "limited"):
        assert getattr(fast.images, name).shape == getattr(whole.images, name).shape, name
    limits = [(r.stereo.min_disparity, r.stereo.max_disparity) for r in (whole, fast)]
    assert limits[0] == limits[1]
    assert abs(fast.visibility.mean_attenuation - whole.visibility.mean_attenuation) < 0.04
    # The images are as sharp as ever: they are not made from the small ones. Their contrast is
    # that of the water that either sees, blurred ones have 0.81 of the sharpness.
    sharpness = [
        np.abs(np.diff(image, axis=1)).mean() / image.std()
        for image in (result.left_enhanced.astype(float) for result in (whole, fast))
    ]
    assert sharpness[1] > 0.95 * sharpness[0]


def test_the_fast_preset_gives_the_same_bits_for_any_number_of_threads(
    pair: tuple[np.ndarray, np.ndarray],
) -> None:
    results = [
        Pipeline(
            RIG, PipelineConfig.from_parameters({"stereo.reduction": 2, "threads": threads})
        ).process(*pair)
        for threads in (1, 2)
    ]
    for name in ("disparity", "filled"):
        np.testing.assert_array_equal(*(getattr(result.stereo, name) for result in results))
    for name in ("left", "right"):
        np.testing.assert_array_equal(*(getattr(result.images, name) for result in results))


@pytest.mark.parametrize("contrast", [0.0, 60.0])
def test_fine_texture_of_a_small_view_is_not_taken_for_noise(contrast: float) -> None:
    generator = np.random.default_rng(5)
    # Smooth at the size of the camera, texture of every second pixel at a quarter of it.
    coarse = generator.uniform(-contrast, contrast, (60, 80, 3)).repeat(8, 0).repeat(8, 1)
    image = 128.0 + cv2.GaussianBlur(coarse, (0, 0), 2.0) + generator.normal(0.0, 3.0, coarse.shape)
    view = View.of(np.round(image).clip(0, 255).astype(np.uint8))
    small = Pyramid(4, view.shape).downsample_view(view)
    assert small.shape == (120, 160)
    # In noise a mean has more than 8 bits. That of sixteen pixels has a quarter of their noise.
    noise = small.noise / 257
    assert np.all(noise <= view.noise / 4 * (1 + 1e-9))
    if contrast == 0.0:
        np.testing.assert_allclose(noise, 0.75, rtol=0.2)
    assert small.colour is not None and np.array_equal(small.colour.noise, small.noise)


def test_means_of_noisy_pixels_tell_a_tenth_of_a_code() -> None:
    steps = np.linspace(100.0, 103.0, 31)[:, np.newaxis, np.newaxis]
    image = np.broadcast_to(steps, (31, 400, 3)).repeat(8, axis=0)
    image = image + np.random.default_rng(2).normal(0.0, 2.0, image.shape)
    view = View.of(np.round(image).astype(np.uint8))
    reduction = Pyramid(2, view.shape)
    small = reduction.downsample_view(view).pixels
    assert small.dtype == np.uint16
    bands = (small / 257).reshape(31, 4, -1).mean(axis=(1, 2))
    np.testing.assert_allclose(bands, steps[:, 0, 0], atol=0.1)
    # White stays white.
    white = reduction.downsample_view(replace(view, pixels=np.full_like(view.pixels, 255)))
    assert (white.pixels == 65535).all()


def test_what_has_no_noise_keeps_its_type() -> None:
    smooth = np.tile(np.linspace(20, 200, 400)[np.newaxis, :, np.newaxis], (240, 1, 3))
    view = View.of(np.round(smooth).astype(np.uint8))
    small = Pyramid(2, view.shape).downsample_view(view)
    assert small.pixels.dtype == np.uint8
