# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's plain fit against closed forms."""

import numpy as np
import pytest

from uw_visibility.status import Status
from uw_visibility_lab.evaluation.fits import BOUNDS, fit_plain

KAPPA = np.array([0.228, 0.066, 0.025])
RANGES = np.tile(np.linspace(1.0, 8.0, 200), (150, 1))


def seen(attenuation, light, radiance=None):
    """Code values of patches, black in every fifth row, at ranges that rise along rows."""
    left = np.exp(-np.outer(RANGES[0], attenuation))
    shade = np.linspace(0.0, 1.0, 150) if radiance is None else radiance
    shade = np.where(np.arange(150) % 5 == 0, 0.0, shade)[:, np.newaxis, np.newaxis]
    irradiance = light * (1.0 - left + shade * left)
    return np.round(np.clip(irradiance, 0, 1) * 65535).astype(np.uint16)


@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.5])
def test_black_patches_give_the_water(alpha):
    beta, light = KAPPA + alpha, np.array([0.5, 0.8, 0.9])
    found = fit_plain(seen(beta, light), RANGES, KAPPA)
    assert found.status is Status.OK
    np.testing.assert_allclose(found.attenuation, beta, rtol=0.04, atol=0.01)
    np.testing.assert_allclose(found.ambient_light, light, rtol=0.12)
    assert (found.attenuation_stddev > 0).all()


def test_what_is_not_black_misleads_it():
    beta, light = KAPPA + 0.2, np.array([0.5, 0.8, 0.9])
    ranges = RANGES.copy()
    ranges[::5] = np.nan
    found = fit_plain(seen(beta, light, np.linspace(0.2, 1.0, 150)), ranges, KAPPA)
    assert (np.abs(found.attenuation - beta) > 0.1 * beta).any()


def test_ambient_light_is_bounded_by_the_bright_patch():
    image = seen(KAPPA + 0.2, np.full(3, 0.3))
    image[1::5] = 40000
    found = fit_plain(image, RANGES, KAPPA)
    assert (found.ambient_light >= 0.6).all()


def test_too_little_is_refused():
    image = seen(KAPPA + 0.2, np.full(3, 0.5))
    none = np.full_like(RANGES, np.nan)
    assert fit_plain(image, none, KAPPA).status is Status.TOO_FEW_OBSERVATIONS
    wall = np.full_like(RANGES, 3.0)
    assert fit_plain(image, wall, KAPPA).status is Status.RANGE_SPREAD_TOO_SMALL
    thick = fit_plain(seen(np.full(3, 80.0), np.full(3, 0.5)), RANGES, KAPPA)
    assert thick.status is Status.FIT_FAILED or (thick.attenuation <= BOUNDS[1]).all()
