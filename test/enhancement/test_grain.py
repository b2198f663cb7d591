# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Grain: what of an image counts as noise, and what restoration does with it."""


import numpy as np
import pytest
from scenes import restored_water

from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.grain import REACH, find_grain
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.optics.transfer import linear_table

NOISE = np.full(3, 2.0)
WATER = restored_water(attenuation=np.full(3, 0.3), ambient_light=np.full(3, 0.6))
SHAPE = (120, 160)
# e^(βd) is 3.3.
FAR = np.full(SHAPE, 4.0, np.float32)
FREE = EnhancementConfig(max_gain=100.0, max_noise=10.0)


def noisy(light: np.ndarray | float, seed: int = 0, dtype: type = np.uint8) -> np.ndarray:
    """Code values of (120, 160, 3) with noise of two codes, of 8 or of 16 bits."""
    values = np.broadcast_to(light, (*SHAPE, 3))
    values = values + np.random.default_rng(seed).normal(0.0, 2.0, (*SHAPE, 3))
    return np.rint(values).astype(dtype)


def grain_of(image: np.ndarray, transfer: str = "linear") -> float:
    """Deviation of the grain, as of 255 codes of light."""
    return 255.0 * float(find_grain(image, NOISE, linear_table(transfer, image.dtype)).std())


def checks(height: float) -> np.ndarray:
    y, x = np.indices(SHAPE)
    return np.where((y // 2 + x // 2) % 2, height, -height)[..., np.newaxis]


def test_noise_is_grain_on_a_wall_and_on_a_slope_and_detail_is_none() -> None:
    slope = np.linspace(60.0, 180.0, 160)[np.newaxis, :, np.newaxis]
    for light in (120.0, slope):
        assert 1.7 < grain_of(noisy(light)) < 2.1
    assert grain_of(noisy(120.0 + checks(20.0))) < 0.02 * 20.0


def test_grain_is_counted_in_light() -> None:
    """Dark codes of sRGB differ by less light than bright ones."""
    dark, bright = (grain_of(noisy(level), "srgb") for level in (40.0, 220.0))
    assert bright > 4.0 * dark


def test_a_flat_wall_is_restored_with_the_noise_that_it_had() -> None:
    image = noisy(140.0)
    enhanced, _ = Restorer(FREE).restore(image, FAR, WATER, NOISE)
    plain, _ = Restorer(FREE).restore(image, FAR, WATER, np.zeros(3))
    assert abs(float(enhanced.mean()) - float(plain.mean())) < 1.0
    assert plain.std() > 5.0 * image.std()
    assert enhanced.std() < 2.0 * image.std()


def test_detail_gets_its_contrast_back() -> None:
    image = noisy(140.0 + checks(15.0))
    enhanced, _ = Restorer(FREE).restore(image, FAR, WATER, NOISE)
    plain, _ = Restorer(FREE).restore(image, FAR, WATER, np.zeros(3))
    assert np.abs(enhanced.astype(int) - plain).mean() < 0.03 * plain.std()


def test_an_edge_has_no_halo() -> None:
    """A step of ten deviations of noise stands, but for a tenth, wherever it falls among cells."""
    for place in range(78, 87):
        image = np.full((*SHAPE, 3), 140, np.uint8)
        image[:, place:] = 160
        enhanced, _ = Restorer(FREE).restore(image, FAR, WATER, NOISE)
        plain, _ = Restorer(FREE).restore(image, FAR, WATER, np.zeros(3))
        assert np.abs(enhanced.astype(int) - plain).max() <= 0.1 * (20 * 5.5)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_what_has_no_range_keeps_its_noise_bit_by_bit(dtype: type) -> None:
    image = noisy(140.0, dtype=dtype)
    enhanced, _ = Restorer(FREE).restore(image, np.full(SHAPE, np.nan, np.float32), WATER, NOISE)
    np.testing.assert_array_equal(enhanced, image)


def test_a_band_has_the_grain_of_the_image() -> None:
    image = noisy(np.linspace(60.0, 180.0, 120)[:, np.newaxis, np.newaxis])[:118]
    decode = linear_table("linear", np.uint8)
    whole = find_grain(image, NOISE, decode)
    for top in (40, 64):
        beyond = find_grain(image[top - REACH :], NOISE, decode)
        np.testing.assert_array_equal(beyond[REACH:], whole[top:])
        above = find_grain(image[: top + REACH], NOISE, decode)
        np.testing.assert_array_equal(above[:top], whole[:top])


@pytest.mark.parametrize("shape", [(1, 1), (3, 50), (50, 3), (37, 41)])
def test_sizes_that_no_cells_fill(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 256, (*shape, 3)).astype(np.uint8)
    grain = find_grain(image, NOISE, linear_table("linear", np.uint8))
    assert grain.shape == (*shape, 3) and np.isfinite(grain).all()
    enhanced, _ = Restorer().restore(image, np.full(shape, 2.0, np.float32), WATER, NOISE)
    assert enhanced.shape == image.shape
