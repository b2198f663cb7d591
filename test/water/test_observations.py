# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Envelopes against quantiles taken one by one."""

import numpy as np
import pytest

from uw_visibility.water.blocks import Blocks
from uw_visibility.water.observations import FEWEST_OF_BIN, observe


def blocks(size=(100, 120), seed=0, noise=0.0, **changes):
    """Blocks of random light over ranges from 2 to 4 m."""
    light = np.random.default_rng(seed).uniform(0.1, 0.9, (*size, 3)).astype(np.float32)
    ranges = np.tile(np.linspace(2, 4, size[1], dtype=np.float32), (size[0], 1))
    made = Blocks(
        light, ranges, 1.0, np.zeros(3), np.zeros(3), np.full(3, noise / 255), False, False)
    return made._replace(**changes)


def test_envelopes_are_the_extremes_of_each_bin():
    seen = observe(made := blocks())
    middles = np.sqrt(seen.range[1:] * seen.range[:-1])
    for at in range(1, len(seen.range) - 1):
        inside = (made.range > middles[at - 1]) & (made.range < middles[at])
        for channel in range(3):
            values = made.light[..., channel][inside]
            assert seen.dark[channel, at] == pytest.approx(np.sort(values)[2], abs=0.02)
            assert seen.bright[channel, at] == pytest.approx(np.quantile(values, 0.99), abs=0.02)
    assert (np.diff(seen.range) > 0).all()
    assert seen.limits == (2.0, pytest.approx(4.0, abs=0.02))
    assert seen.step == pytest.approx(1 / 255, rel=1e-3)


def test_neither_a_crowd_nor_a_few_far_blocks_take_all_bins():
    crowded = blocks()
    crowded.range[:] = np.linspace(2, 4, 120, dtype=np.float32) ** 2 / 4
    apart = np.diff(observe(crowded).range)
    assert apart[-6:-1].mean() > 1.3 * apart[1:6].mean()


def test_the_darkest_blocks_know_their_range():
    made = blocks()
    made.light[:] = 0.5
    made.light[::2, 60] = 0.2
    seen = observe(made)
    at = int(seen.dark[0].argmin())
    assert seen.dark_range[:, at] == pytest.approx(made.range[0, 60])


def test_blocks_that_do_not_count_are_left_out():
    made = blocks()
    before = observe(made)
    made.light[:, 30:32] = 0.001
    made.range[:, 30:32] = np.nan
    made.light[:, 70] = np.nan
    after = observe(made)
    assert after.dark.min() > 0.05
    assert after.count.sum() < before.count.sum()


def test_noise_is_taken_out_of_the_dark_envelope():
    """Where noise alone makes the dark end, its quantile is given back; σ says how well."""
    made = blocks(noise=3.0)
    clean = np.full(made.light.shape, 0.4, np.float32)
    noisy = clean + np.random.default_rng(1).normal(0, 3 / 255, clean.shape).astype(np.float32)
    seen = observe(made._replace(light=noisy))
    assert seen.dark.mean() == pytest.approx(0.4, abs=0.003)
    assert np.abs(seen.dark - 0.4).max() < 0.03
    assert observe(made._replace(light=noisy, noise=np.zeros(3))).dark.mean() < 0.38
    # A block is the mean of many pixels.
    of_many = observe(made._replace(light=clean, size=10))
    assert (of_many.deviation < 0.4 * seen.deviation.mean()).all()


def test_codes_of_a_camera_span_more_light_where_srgb_is_steeper():
    linear, srgb = observe(blocks()), observe(blocks(encoded=True))
    assert (srgb.step[:, 0] < linear.step[:, 0]).all()
    bright = blocks(encoded=True)
    bright.light[:] += 0.09
    assert (observe(bright).step.mean() > srgb.step.mean())


def test_bins_with_too_few_blocks_are_left_out():
    made = blocks(size=(12, 60))
    made.range[:, 50:] = np.linspace(20, 24, 10)
    seen = observe(made)
    assert (seen.count >= FEWEST_OF_BIN).all()
    few = blocks(size=(4, 5))
    assert len(observe(few).range) == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_a_map_without_any_range_gives_no_bin(value):
    made = blocks()
    made.range[:] = np.nan if value == -1.0 else value
    if np.isinf(value):
        made.light[:] = np.nan
    seen = observe(made)
    assert len(seen.range) == 0
    assert seen.limits == (0.0, 0.0)


def test_one_range_for_all_is_no_error():
    made = blocks()
    made.range[:] = 3.0
    seen = observe(made)
    assert seen.limits == (3.0, 3.0)
    assert seen.range == pytest.approx(3.0)


def test_colour_is_noticed():
    made = blocks()
    assert not observe(made).grey
    grey = np.repeat(made.light[..., :1], 3, axis=2)
    assert observe(made._replace(light=grey)).grey
    grey[5, 5, 0] += 0.01
    assert not observe(made._replace(light=grey)).grey


def test_least_light_is_the_third_brightest_bin():
    made = blocks()
    made.light[:] = 0.3
    made.light[:, 60:100] = 0.6
    made.light[:, 10:13] = 0.9
    seen = observe(made)
    assert seen.least_light(0) == pytest.approx(np.sort(seen.bright[0])[-3])
    assert seen.brightest_near(0)[0] == pytest.approx(0.9)
    assert seen.brightest_near(0)[1] < 2.5
