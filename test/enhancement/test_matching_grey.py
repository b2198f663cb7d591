# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The matcher's grey image: unbiased, with the noise it claims, and with little of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from uw_visibility.config import EnhancementConfig
from uw_visibility.enhancement.matching_grey import MatchingGrey
from uw_visibility.enhancement.radiance import recover_radiance
from uw_visibility.errors import InputError
from uw_visibility.parallel import Workers
from uw_visibility.water.light_model import attenuate

WATER = SimpleNamespace(
    attenuation=np.array([0.43, 0.27, 0.22]), ambient_light=np.array([0.4, 0.6, 0.65])
)
SHAPE = (120, 160)
SENSOR_NOISE = 1.5


def noisy(radiance: float, distance: np.ndarray, seed: int = 0) -> np.ndarray:
    colour = np.full((*SHAPE, 3), radiance, np.float32)
    light = attenuate(colour, distance, WATER.attenuation, WATER.ambient_light) * 65535
    noise = np.random.default_rng(seed).normal(0, SENSOR_NOISE * 257, light.shape)
    return np.clip(light + noise + 0.5, 0, 65535).astype(np.uint16)


def grey_of(image: np.ndarray, distance: np.ndarray, smooth: bool, threads: int = 1):  # type: ignore[no-untyped-def]
    config = EnhancementConfig(sensor_noise=SENSOR_NOISE)
    tool = MatchingGrey(SHAPE, config, workers=Workers(threads))
    return tool.compute(image, distance, WATER, smooth)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("metres", [1.0, 4.0, 7.0])
def test_mean_and_noise_are_what_is_claimed(metres: float, smooth: bool) -> None:
    distance = np.full(SHAPE, metres, np.float32)
    grey, claimed = grey_of(noisy(0.5, distance), distance, smooth)
    inside = grey[4:-4, 4:-4].astype(np.float64)
    assert abs(inside.mean() - 127.5) < 0.3
    # Rounding to grey levels adds 1/12 of a level's square.
    expected = np.sqrt(claimed[10, 10] ** 2 + 1 / 12)
    assert inside.std() == pytest.approx(expected, rel=0.05)


def test_less_noise_than_the_usual_grey() -> None:
    distance = np.full(SHAPE, 4.0, np.float32)
    image = noisy(0.5, distance)
    usual = 255 * recover_radiance(image, distance, WATER) @ np.array([0.299, 0.587, 0.114])
    grey, _ = grey_of(image, distance, smooth=False)
    assert grey.std() < 0.92 * usual.std()


def test_smoothing_follows_the_noise() -> None:
    distance = np.full(SHAPE, 0.3, np.float32)
    distance[:, 80:] = 7.0
    image = noisy(0.5, distance)
    plain, before = grey_of(image, distance, smooth=False)
    smooth, after = grey_of(image, distance, smooth=True)
    assert after[60, 20] > 0.6 * before[60, 20]
    assert after[60, 140] < 0.4 * before[60, 140]
    assert smooth[:, 90:].std() < 0.5 * plain[:, 90:].std()


def test_unknown_range_stays_finite() -> None:
    distance = np.full(SHAPE, 2.0, np.float32)
    distance[5] = np.nan
    grey, noise = grey_of(noisy(0.5, np.full(SHAPE, 2, np.float32)), distance, smooth=True)
    assert np.isfinite(noise).all()
    assert noise[5].min() > noise[50].max()
    assert grey.dtype == np.uint8


def test_channel_that_is_not_assessable_is_left_out() -> None:
    distance = np.full(SHAPE, 2.0, np.float32)
    image = noisy(0.5, distance)
    part = SimpleNamespace(
        attenuation=np.array([np.nan, 0.27, 0.22]), ambient_light=WATER.ambient_light
    )
    wild = image.copy()
    wild[..., 0] = 0
    tool = MatchingGrey(SHAPE)
    np.testing.assert_array_equal(
        tool.compute(image, distance, part)[0], tool.compute(wild, distance, part)[0]
    )
    nothing = SimpleNamespace(attenuation=np.full(3, np.nan), ambient_light=np.full(3, np.nan))
    with pytest.raises(InputError, match="raw images"):
        tool.compute(image, distance, nothing)


def test_same_bits_for_any_number_of_threads() -> None:
    distance = np.random.default_rng(2).uniform(0.5, 9, SHAPE).astype(np.float32)
    image = noisy(0.4, distance)
    one = grey_of(image, distance, smooth=True)
    three = grey_of(image, distance, smooth=True, threads=3)
    np.testing.assert_array_equal(one[0], three[0])
    np.testing.assert_array_equal(one[1], three[1])
