# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's plain fit against closed forms."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import KAPPA

from uw_visibility.water.daylight.fit import ATTENUATION_BOUNDS, fit_plain
from uw_visibility.water.observations import Envelopes

ALL = np.ones(3, dtype=bool)


def plain(beta, light, distance, bright, active=ALL):
    dark = light[:, np.newaxis] * (1 - np.exp(-np.outer(beta, distance)))
    bins = (3, len(distance))
    envelope = Envelopes(
        distance, np.full(len(distance), 100), dark, np.broadcast_to(distance, bins),
        np.broadcast_to(bright[:, np.newaxis], bins), np.full(bins, 1 / 255), np.zeros(bins),
        np.zeros(3), np.zeros(3), False, (float(distance[0]), float(distance[-1])))
    return fit_plain(envelope, KAPPA, active)


@given(st.floats(0.0, 0.6), st.floats(0.5, 6.0), st.floats(2.0, 5.0))
@settings(max_examples=12, deadline=None)
def test_black_patches_give_the_water(alpha, depth, stretch):
    beta = KAPPA + alpha
    light = np.exp(-beta * depth)
    # A white patch: the bright envelope is the ambient light itself.
    found = plain(beta, light, np.linspace(1.5, 1.5 * stretch, 40), light)
    np.testing.assert_allclose(found.parameters[:, 0], beta, rtol=0.02, atol=2e-3)
    assert found.converged


def test_ambient_light_beyond_the_bright_patch_comes_from_the_course_over_range():
    beta, light = KAPPA + 0.4, np.array([0.5, 0.7, 0.8])
    found = plain(beta, light, np.linspace(0.5, 12, 48), 0.6 * light)
    np.testing.assert_allclose(found.parameters[:, 1], light, rtol=0.02)
    np.testing.assert_allclose(found.parameters[:, 0], beta, rtol=0.04)


def test_ambient_light_is_bounded_by_the_bright_patch():
    found = plain(KAPPA + 0.2, np.full(3, 0.3), np.linspace(1, 8, 40), np.full(3, 0.5))
    assert (found.parameters[:, 1] >= 0.5).all()


def test_channels_left_out_are_not_invented():
    found = plain(
        KAPPA + 0.2, np.full(3, 0.5), np.linspace(1, 8, 40), np.full(3, 0.5),
        np.array([True, False, True]))
    assert np.isnan(found.parameters[1]).all()
    assert np.isnan(found.covariance[2:4]).all()
    assert np.isfinite(found.parameters[[0, 2]]).all()


def test_attenuation_stays_within_its_bounds():
    found = plain(np.full(3, 80.0), np.full(3, 0.5), np.linspace(1, 8, 40), np.full(3, 0.5))
    assert (found.parameters[:, 0] <= ATTENUATION_BOUNDS[1]).all()
