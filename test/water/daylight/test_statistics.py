# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Statistics do not depend on exposure, metres or side; curves find the water that made them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from uw_visibility.images.view import View
from uw_visibility.water.blocks import Blocks, reduce_to_blocks
from uw_visibility.water.daylight.curves import (
    GAMMA,
    KEPT,
    OF_CURVES,
    SLOWER,
    THICKNESS,
    curves,
    level,
)
from uw_visibility.water.daylight.statistics import (
    BETWEEN_HALVES,
    BINS,
    COARSE,
    COARSE_STEP,
    COMPARED,
    FLOOR,
    IS_WATER,
    LOCAL,
    LOWER_ROW,
    LOWER_WATER,
    OF_BIN,
    OF_CHANNEL,
    OF_IMAGE,
    QUANTILES,
    RANGES,
    ROW,
    ROWS,
    TILES,
    UPPER_ROW,
    UPPER_WATER,
    WEIGHT,
    WITHIN_TILE,
    Statistics,
    summarise,
)

CLEAR = np.array((0.228, 0.066, 0.0245))
SHAPE = (240, 320)


def ranges_of(shape: tuple[int, int] = SHAPE) -> NDArray[np.float32]:
    """Ranges from 2 m below to 6 m above, unknown in the topmost sixth."""
    rows = np.geomspace(6.0, 2.0, shape[0])[:, np.newaxis]
    ranges = np.repeat(rows, shape[1], axis=1).astype(np.float32)
    ranges[:shape[0] // 6] = np.nan
    return ranges


def picture(seed: int = 0, attenuation: float = 0.2) -> NDArray[np.uint16]:
    """A floor of random reflectance in the paper's water, and open water above it."""
    rng = np.random.default_rng(seed)
    left = np.exp(-attenuation * np.nan_to_num(ranges_of(), nan=np.inf))[..., np.newaxis]
    reflectance = rng.beta(1.0, 2.0, (*SHAPE, 3))
    return np.asarray(
        20000.0 * (0.7 * reflectance * left + 0.5 * (1.0 - left)), np.float64).astype(np.uint16)


def blocks_of(
    image: NDArray[np.uint8] | NDArray[np.uint16], ranges: NDArray[np.float32]
) -> Blocks:
    samples = View.of(np.ascontiguousarray(image)).colour
    assert samples is not None
    return reduce_to_blocks(samples, np.ascontiguousarray(ranges), None)


def summary(
    image: NDArray[np.uint8] | NDArray[np.uint16], ranges: NDArray[np.float32],
    clear_water: NDArray[np.float64] = CLEAR, range_error: float = 0.01,
) -> Statistics:
    found = summarise(blocks_of(image, ranges), range_error, clear_water)
    assert found is not None
    return found


def test_exposure_changes_brightness_alone() -> None:
    image, ranges = picture(), ranges_of()
    one, other = summary(image, ranges), summary(image * np.uint16(2), ranges)
    np.testing.assert_allclose(one.of_bins, other.of_bins, atol=2e-3)
    np.testing.assert_allclose(other.brightest / one.brightest, 2.0, rtol=1e-3)
    assert np.abs(one.of_channels[:, 6] - other.of_channels[:, 6]) == pytest.approx(np.log(2.0))


def test_the_unit_of_length_changes_the_median_range_alone() -> None:
    image, ranges = picture(), ranges_of()
    one = summary(image, ranges, range_error=0.03)
    other = summary(image, np.float32(3.0) * ranges, CLEAR / 3.0)
    np.testing.assert_array_equal(one.of_bins, other.of_bins)
    np.testing.assert_allclose(one.of_channels, other.of_channels, atol=1e-5)
    np.testing.assert_allclose(one.of_image[1:], other.of_image[1:], atol=1e-5)
    assert other.median_range == pytest.approx(3.0 * one.median_range)


def test_a_mirrored_image_changes_the_sign_of_left_and_right_alone() -> None:
    image, ranges = picture(), ranges_of()
    image[:, 160:] //= np.uint16(2)
    one, other = summary(image, ranges), summary(image[:, ::-1], ranges[:, ::-1])
    sides = slice(BETWEEN_HALVES, BETWEEN_HALVES + len(COMPARED))
    assert (one.of_bins[..., sides] > 0.3).all()
    np.testing.assert_allclose(one.of_bins[..., sides], -other.of_bins[..., sides], atol=1e-5)
    rest = np.delete(np.arange(OF_BIN), np.arange(OF_BIN)[sides])
    np.testing.assert_allclose(one.of_bins[..., rest], other.of_bins[..., rest], atol=1e-5)


def test_open_water_is_seen_with_its_light() -> None:
    image = picture()
    found = summary(image, ranges_of())
    assert found.of_image[4] > 0.1 and found.of_image[5] == 1.0
    seen = np.exp(found.of_channels[:, 0]) - FLOOR
    np.testing.assert_allclose(seen * found.brightest, 10000.0 / 65535.0, rtol=0.01)
    assert summary(image[60:], ranges_of()[60:]).of_image[5] == 0.0


def test_unmatched_ground_is_hardly_taken_for_open_water() -> None:
    # Even ground, of which patches are not matched, up to the upper edge.
    image = np.full((*SHAPE, 3), 9000, np.uint16)
    image += np.random.default_rng(1).integers(0, 200, image.shape).astype(np.uint16)
    ranges = np.repeat(np.geomspace(6.0, 2.0, SHAPE[0])[:, np.newaxis], SHAPE[1], axis=1)
    ranges[:12, np.random.default_rng(2).random(SHAPE[1] // 8).repeat(8) < 0.5] = np.nan
    ground = summary(image, ranges.astype(np.float32)).of_channels[:, IS_WATER]
    assert summary(picture(), ranges_of()).of_channels[:, IS_WATER].min() > 0.8
    assert ground.max() < 0.2


def test_what_is_behind_surfaces_is_no_open_water() -> None:
    ranges = ranges_of()
    ranges[:10] = 7.0
    assert summary(picture(), ranges).of_channels[:, IS_WATER].max() == 0.0


def test_quantiles_are_those_of_the_bin() -> None:
    image, ranges = picture(), ranges_of()
    found, blocks = summary(image, ranges), blocks_of(image, ranges)
    middle = np.exp(found.of_image[RANGES][6]) * found.median_range
    there = np.abs(np.log(blocks.range / middle)) < 0.03
    expected = np.quantile(blocks.light[there], (0.05, 0.5, 0.95), axis=0).T
    seen = (np.exp(found.of_bins[:, 6, [2, 4, 6]]) - FLOOR) * found.brightest[:, np.newaxis]
    np.testing.assert_allclose(seen, expected, rtol=0.08)


def test_a_channel_without_light_and_odd_ranges_are_numbers() -> None:
    image, ranges = picture(), ranges_of()
    image[..., 0] = 0
    ranges[200:210] = np.inf
    ranges[210:215] = -1.0
    ranges[215:220] = 1e30
    found = summary(image, ranges)
    for values in (*found[:4], curves(*found[:4])):
        assert np.isfinite(values).all()
    assert found.of_channels[0, 8] == 1.0


@pytest.mark.parametrize("unknown", [np.nan, 0.0, -2.0, np.inf])
def test_without_ranges_there_is_nothing(unknown: float) -> None:
    nowhere = blocks_of(picture(), np.full(SHAPE, unknown, np.float32))
    assert summarise(nowhere, 0.0, CLEAR) is None


# Fits in the order of `curves`, and whether the veil is kept of each.
FITS = {
    "all": True, "dark": False, "black": True, "open water": False, "black, open water": False,
    "tiles, open water": False, "all, gradient": True, "black, gradient": True, "tiles": True,
    "tiles, gradient": True, "tiles, slower veil": False,
    "tiles, slower veil, some open water": False, "all, gamma undone": False,
    "all, gamma made": False, "local contrast": False, "coarse contrast": False,
    "contrast within tiles": False}
# Of another world than that of the other fits.
OTHER = ("contrast", "slower", "gamma")


def guesses(found: NDArray[np.float32]) -> tuple[dict[str, float], dict[str, float]]:
    """Attenuation and veil where the residuals of each fit are least, of one channel."""
    number, grid = len(FITS), len(THICKNESS)
    residuals, _, at, rest = np.split(
        found[BINS * OF_BIN + 1:], np.cumsum((number * grid, number, number)))
    assert (residuals.reshape(number, grid).min(axis=1) == 0.0).all()
    with_veil = [name for name, keeps_veil in FITS.items() if keeps_veil]
    first = len(with_veil) * len(THICKNESS[KEPT])
    assert first + len(with_veil) + 8 == len(rest)
    return (
        dict(zip(FITS, np.exp(at).tolist(), strict=True)),
        dict(zip(with_veil, np.exp(rest[first:-8]).tolist(), strict=True)))


def least_residual(found: NDArray[np.float32], name: str) -> float:
    """ln of the mean squared residual of a fit where it is least."""
    least = found[BINS * OF_BIN + 1 + len(FITS) * len(THICKNESS):]
    return float(least[list(FITS).index(name)])


def made_of(
    attenuation: float, gradient: float = 0.0, noise: float = 0.0, water: bool = True,
    growth: float = 1.0, exponent: float = 1.0,
) -> list[NDArray[np.float32]]:
    """Statistics of a floor whose range falls from the upper to the lower rows, exactly."""
    distance = np.geomspace(2.5, 0.5, BINS)
    rows = np.linspace(-0.1, 0.5, BINS)
    left = np.exp(-attenuation * distance)
    veil = 0.4 * (1.0 - gradient * rows)
    reflectance = np.array((0.0, 0.0, 0.05, 0.2, 0.4, 0.6, 0.9, 1.0))
    dim = veil * (1.0 - left**growth)
    quantiles = dim[:, np.newaxis] + 0.9 * reflectance * left[:, np.newaxis]
    of_bins = np.zeros((3, BINS, OF_BIN), np.float32)
    of_bins[..., :len(QUANTILES)] = np.log(quantiles**exponent + FLOOR)
    of_bins[..., LOCAL] = 0.5 * np.log(0.01 * left**2 + noise**2)
    of_bins[..., COARSE] = 0.5 * np.log(0.02 * left**2 + noise**2)
    of_bins[..., WITHIN_TILE] = 0.5 * np.log(0.04 * left**2 + noise**2)
    of_bins[..., -1] = 1.0
    of_image = np.zeros(OF_IMAGE, np.float32)
    of_image[RANGES], of_image[ROWS] = np.log(distance), rows
    of_tiles = np.zeros((5, TILES, BINS), np.float32)
    of_tiles[:3] = dim + 0.9 * np.linspace(
        0.1, 0.9, TILES)[:, np.newaxis] * left
    of_tiles[WEIGHT], of_tiles[ROW] = 1.0, rows
    of_channels = np.zeros((3, OF_CHANNEL), np.float32)
    if water:
        of_image[UPPER_ROW], of_image[LOWER_ROW] = -0.45, -0.25
        of_channels[:, IS_WATER] = 1.0
        of_channels[:, UPPER_WATER] = np.log(0.4 * (1.0 + 0.45 * gradient) + FLOOR)
        of_channels[:, LOWER_WATER] = np.log(0.4 * (1.0 + 0.25 * gradient) + FLOOR)
    return [of_bins, of_tiles, of_channels, of_image]


@pytest.mark.parametrize("attenuation", [0.1, 0.3, 0.7])
@pytest.mark.parametrize("water", [True, False])
def test_residuals_are_least_at_the_water_that_made_the_statistics(
    attenuation: float, water: bool
) -> None:
    found = curves(*made_of(attenuation, water=water))
    assert found.shape == (3, OF_CURVES)
    attenuations, veils = guesses(found[1])
    for name, seen in attenuations.items():
        if any(word in name for word in OTHER) or (name.endswith("open water") and not water):
            continue
        assert seen == pytest.approx(attenuation, rel=0.06), name
    for name, seen in veils.items():
        assert seen == pytest.approx(0.4, rel=0.12), name
    # Contrast falls as e^(−βd).
    np.testing.assert_allclose(found[:, -8], -attenuation, atol=0.02)


@pytest.mark.parametrize("attenuation", [0.3, 0.7])
@pytest.mark.parametrize("water", [True, False])
def test_a_veil_that_is_brighter_above_is_one_of_the_models(
    attenuation: float, water: bool
) -> None:
    """What far surfaces gain by it looks like slower decay where the veil is one."""
    attenuations, veils = guesses(curves(*made_of(attenuation, gradient=0.5, water=water))[1])
    for name in ("all", "black", "tiles"):
        assert attenuations[f"{name}, gradient"] == pytest.approx(attenuation, rel=0.05), name
        assert veils[f"{name}, gradient"] == pytest.approx(0.4, rel=0.04), name
    if not water:
        assert attenuations["black"] < 0.6 * attenuation


@pytest.mark.parametrize("attenuation", [0.3, 0.7])
def test_open_water_tells_the_gradient_of_the_veil_and_levels_it(attenuation: float) -> None:
    even, sloping = (level(*made_of(attenuation, gradient=g)) for g in (0.0, 0.5))
    np.testing.assert_allclose(even.slope, 0.0, atol=1e-6)
    np.testing.assert_allclose(sloping.slope, -0.2, rtol=0.03)
    np.testing.assert_allclose(sloping.water, 0.4, rtol=0.01)
    for one, other in ((even.of_bins, sloping.of_bins), (even.of_tiles, sloping.of_tiles)):
        np.testing.assert_allclose(one, other, atol=0.05)
    none = level(*made_of(attenuation, gradient=0.5, water=False))
    np.testing.assert_allclose(none.of_bins, made_of(attenuation, gradient=0.5)[0], atol=1e-5)
    assert not none.slope.any() and not none.water.any()


def test_noise_does_not_slow_the_decay_of_contrast() -> None:
    found = curves(*made_of(0.8, noise=0.02))
    attenuations, _ = guesses(found[1])
    assert attenuations["local contrast"] == pytest.approx(0.8, rel=0.05)
    assert attenuations["coarse contrast"] == pytest.approx(0.8, rel=0.05)
    assert attenuations["contrast within tiles"] == pytest.approx(0.8, rel=0.05)
    assert found[1, -2] > -0.7


@pytest.mark.parametrize("attenuation", [0.5, 0.9])
@pytest.mark.parametrize(("name", "usual", "world"), [
    ("tiles, slower veil", "tiles", {"growth": SLOWER}),
    ("all, gamma undone", "all", {"exponent": 1.0 / GAMMA}),
    ("all, gamma made", "all", {"exponent": GAMMA}),
])
def test_a_world_of_another_kind_is_one_of_the_models(
    attenuation: float, name: str, usual: str, world: dict[str, float]
) -> None:
    """A veil that grows more slowly, and a camera curve that was not told."""
    found = curves(*made_of(attenuation, **world))[1]
    attenuations, _ = guesses(found)
    assert attenuations[name] == pytest.approx(attenuation, rel=0.06)
    assert least_residual(found, name) < least_residual(found, usual) - 0.2
    plain = curves(*made_of(attenuation))[1]
    assert least_residual(plain, name) > least_residual(plain, usual) + 0.2


def test_contrast_within_tiles_is_that_of_the_blocks() -> None:
    """A step between tiles is none within one."""
    image, ranges = picture(), np.full(SHAPE, 3.0, np.float32)
    ranges[:, ::2] = 3.001
    even = np.full_like(image, 20000)
    even[:, 160:] = 5000
    contrast = summary(even, ranges).of_bins[..., WITHIN_TILE]
    assert (contrast == np.log(np.float32(0.5 * FLOOR))).all()
    found, blocks = summary(image, ranges_of()), blocks_of(image, ranges_of())
    middle = np.exp(found.of_image[RANGES][6]) * found.median_range
    there = np.abs(np.log(blocks.range / middle)) < 0.03
    expected = blocks.light[there].std(axis=0) / found.brightest
    np.testing.assert_allclose(np.exp(found.of_bins[:, 6, WITHIN_TILE]), expected, rtol=0.15)


def test_coarse_contrast_is_that_of_blocks_of_a_surface() -> None:
    """Waves of twice the step show whole, those of the step and edges between ranges do not."""
    rows, columns = SHAPE[0] // 2, SHAPE[1] // 2
    ranges = np.repeat(np.geomspace(2.0, 6.0, rows)[:, np.newaxis], columns, axis=1)
    ranges[:, columns // 2:] *= 2.0
    for period, expected in ((2 * COARSE_STEP, 0.1), (COARSE_STEP, 0.0)):
        light = 0.5 + 0.1 * np.sign(np.sin(2 * np.pi * (np.arange(columns) + 0.5) / period))
        light[columns // 2:] += 0.2
        image = np.broadcast_to(light[np.newaxis, :, np.newaxis], (rows, columns, 3))
        blocks = Blocks(
            image.astype(np.float32), ranges.astype(np.float32), 1.0, np.zeros(3), np.zeros(3),
            np.full(3, 1e-4), False, True)
        found = summarise(blocks, 0.01, np.full(3, 0.05))
        assert found is not None
        shown = np.exp(found.of_bins[..., COARSE]) - 0.5 * FLOOR
        np.testing.assert_allclose(shown, 2.0 * expected / found.brightest[0], atol=0.01)
