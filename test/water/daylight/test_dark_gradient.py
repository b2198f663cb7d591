# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Veil and attenuation that change downwards over the image."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.status import Status
from uw_visibility.water.daylight.dark_gradient import find_gradients
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.daylight.position import HalfEnvelopes
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Assessor

ATTENUATION = np.array([0.4, 0.24, 0.2])
VEIL = np.array([0.4, 0.6, 0.7])
SHAPE = (180, 240)


class TestFindGradients:
    """Of ground ahead: far ranges are above, and within each the farther half is."""

    RANGE = np.geomspace(1.5, 9.0, 14)
    ROW = np.linspace(0.9, 0.2, 14)

    def found(
        self, veil: float = 0.0, attenuation: float = 0.0, apart: float = 0.2, wrong: int = 0
    ):
        """Rows of a range so far apart; wrong matches at so many ranges, of light things above."""
        distance = np.stack((1.02 * self.RANGE, 0.98 * self.RANGE))
        rows = np.stack((self.ROW - 0.5 * apart, self.ROW + 0.5 * apart))
        thickness = (ATTENUATION[:, np.newaxis, np.newaxis] + attenuation * (rows - 0.5)) * distance
        light = VEIL[:, np.newaxis, np.newaxis] * (1.0 + veil * (rows - 0.5))
        dark = np.zeros((2, 3, 3, len(self.RANGE)))
        dark[:, 1] = np.moveaxis(light * (1.0 - np.exp(-thickness)), 0, 1)
        rows[0, len(self.RANGE) - wrong:] -= 0.8
        dark[0, 1, :, len(self.RANGE) - wrong:] *= 1.4
        if wrong:
            # Else all others show exactly none.
            dark[0, 1] *= np.random.default_rng(0).normal(1.0, 0.1, dark[0, 1].shape)
        ranges = np.full((2, 3, len(self.RANGE)), np.nan)
        ranges[:, 1] = distance
        place = np.zeros((2, 3, len(self.RANGE), 2))
        place[:, 1, :, 0] = rows
        halves = HalfEnvelopes(ranges, dark, np.full(3, 0.002), place)
        return find_gradients(halves, np.ones(3, bool), ATTENUATION, VEIL, VEIL)

    @pytest.mark.parametrize("slope", [-0.5, -0.25])
    def test_a_veil_that_is_brighter_above(self, slope):
        veil, attenuation = self.found(veil=slope)
        assert veil.slope == pytest.approx(slope, rel=0.25)
        assert veil.odds > 10.0 * max(attenuation.odds, 1.0)

    def test_a_veil_that_is_brighter_below_is_less_likely(self):
        above, below = (self.found(veil=slope)[0] for slope in (-0.1, 0.1))
        assert below.slope == pytest.approx(-above.slope, rel=0.1)
        assert below.odds < 0.4 * above.odds

    def test_water_that_is_more_turbid_below(self):
        veil, attenuation = self.found(attenuation=0.2)
        assert attenuation.slope == pytest.approx(0.2, rel=0.3)
        assert attenuation.odds > max(veil.odds, 1.0)

    def test_nothing_in_one_water(self):
        assert all(gradient.odds < 0.1 for gradient in self.found())

    def test_wrong_matches_at_one_range_tell_of_nothing(self):
        assert all(gradient.odds < 0.1 for gradient in self.found(apart=0.08, wrong=1))

    def test_ground_that_is_seen_in_one_row_at_each_range_tells_nothing(self):
        assert self.found(apart=0.04) is None
        assert self.found(apart=0.04, wrong=2) is None


def ground_ahead(seed: int, veil: float = 0.0, layer: float = 0.0) -> tuple:
    """Render stones on ground ahead; the gradients are upwards, per height of the image.

    Returns the image, ranges in m and effective attenuation in 1/m.
    """
    rng = np.random.default_rng(seed)
    rows = (np.arange(SHAPE[0]) + 0.5) / SHAPE[0]
    ground = 1.5 + 7.0 * (1.0 - rows) ** 1.5
    stones = np.kron(rng.uniform(0.55, 1.0, (SHAPE[0] // 12, SHAPE[1] // 12)), np.ones((12, 12)))
    distance = ground[:, np.newaxis] * stones
    radiance = np.kron(rng.uniform(0.0, 0.9, (SHAPE[0] // 4, SHAPE[1] // 4)) ** 1.5,
                       np.ones((4, 4)))[..., np.newaxis] * np.array([0.9, 1.0, 0.95])
    radiance[rng.random(SHAPE) < 0.05] *= 0.05
    above = (0.5 - rows)[:, np.newaxis, np.newaxis]
    left = np.exp(-(ATTENUATION - layer * above) * distance[..., np.newaxis])
    seen = VEIL * (radiance * left + (1.0 + veil * above) * (1.0 - left))
    codes = np.clip(np.round(255 * seen + rng.normal(0.0, 0.4, seen.shape)), 0, 255)
    return codes.astype(np.uint8), distance.astype(np.float32), ATTENUATION


def estimate(image: np.ndarray, distance: np.ndarray) -> WaterEstimate:
    config = PipelineConfig()
    assessor = Assessor.from_config(config)
    return WaterEstimator(
        config.water, assessor.clear_water_attenuation, "linear", assessor.daylight,
    ).estimate(image, distance, range_error=0.0)


class TestEstimate:
    SEEDS = range(6)

    @pytest.mark.parametrize("veil", [0.0, 0.3, 0.6])
    def test_a_veil_that_is_brighter_above_is_levelled(self, veil):
        """Without open water in view; a single veil would leave half of the attenuation."""
        ratios = []
        for seed in self.SEEDS:
            image, distance, attenuation = ground_ahead(seed, veil)
            found = estimate(image, distance)
            if found.status is Status.OK:
                ratios.append(found.attenuation / attenuation)
                off = np.abs(found.attenuation - attenuation)
                assert (off < 3.0 * found.attenuation_stddev).all()
        assert len(ratios) >= 5
        np.testing.assert_allclose(np.median(ratios, axis=0), 1.0, atol=0.15)

    def test_turbid_water_below_does_not_pass_for_clear(self):
        ratios = []
        for seed in self.SEEDS:
            image, distance, attenuation = ground_ahead(seed, layer=0.12)
            found = estimate(image, distance)
            if found.status is Status.OK:
                ratios.append((found.attenuation / attenuation).min())
                off = np.abs(found.attenuation - attenuation)
                assert (off < 3.0 * found.attenuation_stddev).all()
        assert len(ratios) >= 5
        assert np.median(ratios) > 0.85
