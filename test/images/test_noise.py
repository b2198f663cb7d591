# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Noise is measured beside texture."""

import numpy as np
import pytest

from uw_visibility.images.noise import SMOOTHEST, _smoothest, noise_stddev


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


@pytest.mark.parametrize("count", [1, 2, 7, 200])
def test_the_smoothest_blocks_are_those_of_numpys_quantile(count):
    variances = np.random.default_rng(count).random(count)
    assert _smoothest(variances) == pytest.approx(np.quantile(variances, SMOOTHEST), rel=1e-12)
