# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Noise is measured, and taken out of the estimate."""

import cv2
import numpy as np
import pytest

from uw_visibility.config import WaterConfig
from uw_visibility.status import Status
from uw_visibility.water.estimation import WaterEstimator
from uw_visibility.water.noise import SMOOTHEST, _smoothest, noise_stddev

KAPPA = np.array([0.22776, 0.06641, 0.02455])


@pytest.mark.parametrize("stddev", [0.8, 1.5, 4.0])
def test_noise_is_measured_beside_texture(stddev):
    rng = np.random.default_rng(0)
    image = np.full((240, 320, 3), 90.0)
    image[:, 160:] += 40 * rng.random((240, 160, 1))
    image += rng.normal(0, stddev, image.shape)
    np.testing.assert_allclose(
        noise_stddev((image + 0.5).astype(np.uint8)), stddev, rtol=0.25)


def test_what_has_no_noise_has_none():
    ramp = np.tile(np.linspace(10, 200, 320)[:, np.newaxis], (240, 1, 3)).astype(np.uint8)
    assert (noise_stddev(ramp) < 0.2).all()
    assert (noise_stddev(np.full((100, 100, 3), 7, np.uint8)) == 0).all()
    assert (noise_stddev(np.zeros((5, 5, 3), np.uint8)) == 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_the_estimate_survives_noise_and_marine_snow(make_view, seed):
    view = make_view(alpha=0.15, seed=seed)
    rng = np.random.default_rng(seed)
    noisy = 255 * view.irradiance + rng.normal(0, 1.5, view.irradiance.shape)
    seeds = (rng.random(view.range.shape) < 0.0025).astype(np.uint8)
    flakes = cv2.dilate(seeds, np.ones((2, 2))) > 0
    noisy[flakes] += 60
    image = np.clip(noisy + 0.5, 0, 255).astype(np.uint8)
    found = WaterEstimator(WaterConfig(), KAPPA).estimate(image, view.range)
    assert found.status is Status.OK
    assert abs(np.mean(found.attenuation - view.attenuation)) < 0.02


@pytest.mark.parametrize("count", [1, 2, 7, 200])
def test_the_smoothest_blocks_are_those_of_numpys_quantile(count):
    variances = np.random.default_rng(count).random(count)
    assert _smoothest(variances) == pytest.approx(np.quantile(variances, SMOOTHEST), rel=1e-12)
