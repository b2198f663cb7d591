# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the numbers of the posterior under lamps are fitted to."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uw_visibility.water.daylight.inference import DECLARED
from uw_visibility.water.lamps.posterior import (
    DAYLIGHT_OF_CHANNELS,
    DAYLIGHT_VEIL,
    FITTED,
    REFLECTANCE,
    VEIL_DEVIATION,
    VEIL_OF_CHANNELS,
)
from uw_visibility_lab.posterior.cases import by_lamps
from uw_visibility_lab.posterior.judge import estimate_by_lamps
from uw_visibility_lab.posterior.lamps import between_channels, observe, reefs, score
from uw_visibility_lab.worlds.beliefs import bounds
from uw_visibility_lab.worlds.scenes import SIZE, Scene, procedural
from uw_visibility_lab.worlds.water import draw_water


def test_a_reef_scores_better_by_the_fitted_numbers_than_by_absurd_ones() -> None:
    (case,) = reefs(1)
    night = observe(case)
    assert night is not None and len(night.nodes.range) > 100
    np.testing.assert_array_equal(night.attenuation, case.attenuation)
    # Ground whose trend may be anything, and next to no evidence.
    assert score(FITTED, night) > score(FITTED._replace(trend=1e3, evidence=0.01), night) + 0.1


@pytest.mark.parametrize("seed", [13, 41])
def test_ground_behind_scattered_light_is_found_from_both_sides(seed: int) -> None:
    """From clear water on alone these were off by -2.4, 3.9 and -3.7 standard deviations."""
    scene = procedural(np.random.default_rng((5, seed)))
    (case,) = by_lamps([scene], 1, seed, ("two terms", "blur"))
    found = estimate_by_lamps(case)
    assert case.attenuation is not None
    best = int(np.argmin(case.attenuation))
    off = math.log(found.attenuation[best] / case.attenuation[best])
    assert abs(off) < 1.8 * found.attenuation_stddev[best] / found.attenuation[best]


def test_declared_lamps_are_as_probable_as_daylight_before_a_frame_is_seen() -> None:
    """The networks tell odds for the share of lamps among the views that they were trained on."""
    share = bounds("lamps.share")[0]
    assert math.log(share / (1.0 - share)) + DECLARED == pytest.approx(0.0)


def test_scattered_light_over_ground_differs_between_channels_by_colour_and_albedo() -> None:
    def scenes(colour: tuple[float, float, float]) -> list[Scene]:
        ground = np.broadcast_to(np.array(colour, np.float32), (*SIZE, 3))
        ranges = np.linspace(4.0, 1.0, SIZE[0], dtype=np.float32)[:, np.newaxis]
        return [Scene(
            "plain", "procedural", ground.copy(), np.repeat(ranges, SIZE[1], axis=1))] * 300

    low, high = bounds("lamps.albedo")
    albedo = np.log(np.linspace(low, high, 1000)).std() * math.sqrt(2.0 / 3.0)
    grey, coloured = between_channels(scenes((0.2,) * 3)), between_channels(scenes((0.1, 0.2, 0.4)))
    assert grey == pytest.approx(albedo, rel=0.1)
    assert coloured > math.hypot(albedo, 0.3)


def test_daylight_beside_lamps_is_expected_as_in_the_waters_that_are_drawn() -> None:
    waters = [draw_water(np.random.default_rng(seed)) for seed in range(1000)]
    veil = np.log([water.ratio for water in waters])
    common = veil.mean(axis=1, keepdims=True)
    assert math.exp(common.mean()) == pytest.approx(DAYLIGHT_VEIL * REFLECTANCE, rel=0.15)
    assert common.std() == pytest.approx(VEIL_DEVIATION, rel=0.1)
    assert math.sqrt(np.mean((veil - common) ** 2)) == pytest.approx(VEIL_OF_CHANNELS, rel=0.2)
    # What is left of daylight's colour without that of clear water of the best depth.
    light, clear = (
        values - values.mean(axis=1, keepdims=True) for values in (
            np.log([water.light for water in waters]),
            np.array([water.clear_water for water in waters])))
    depth = -(light * clear).sum(axis=1) / (clear**2).sum(axis=1)
    off = light + depth[:, np.newaxis] * clear
    assert math.sqrt(np.mean(off**2)) == pytest.approx(DAYLIGHT_OF_CHANNELS, rel=0.2)
