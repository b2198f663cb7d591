# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Sea-thru's backscatter fit: the water of its own model, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import in_water, patches

from uw_visibility.status import Status
from uw_visibility_lab.evaluation.fits import fit_backscatter

BETA, VEIL = np.array([0.6, 0.35, 0.3]), np.array([0.2, 0.35, 0.4])


def scene() -> tuple[np.ndarray, np.ndarray]:
    """Black and coloured patches at ranges of 1 to 8 m, in water."""
    random = np.random.default_rng(2)
    radiance = random.random((40, 60, 3))
    radiance[random.random((40, 60)) < 0.1] = 0.0
    ranges = np.tile(np.linspace(1.0, 8.0, 240), (160, 1))
    return in_water(patches(radiance, 4), ranges, BETA, VEIL, dtype=np.uint16), ranges


def test_veil_and_its_coefficient_come_back() -> None:
    image, ranges = scene()
    water = fit_backscatter(image, ranges)
    assert water.status is Status.OK
    np.testing.assert_allclose(water.attenuation, BETA, rtol=0.05)
    np.testing.assert_allclose(water.ambient_light, VEIL, rtol=0.05)
    assert (water.attenuation_stddev < 0.05).all()


def test_unknown_ranges_do_not_count() -> None:
    image, ranges = scene()
    image[:40], ranges[:40] = 0, np.nan
    np.testing.assert_allclose(fit_backscatter(image, ranges).attenuation, BETA, rtol=0.05)


@pytest.mark.parametrize("ranges", [np.full((160, 240), np.nan), np.full((160, 240), 3.0)])
def test_too_few_ranges_are_refused(ranges: np.ndarray) -> None:
    image, _ = scene()
    assert fit_backscatter(image, ranges).status is Status.TOO_FEW_OBSERVATIONS
