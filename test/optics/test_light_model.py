# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The light model against its closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uw_visibility.optics.light_model import ambient_light_at_depth, attenuate

BETA = np.array([0.5, 0.3, 0.2])
AMBIENT = np.array([0.2, 0.6, 0.8])


def image(value):
    return np.full((2, 2, 3), value, dtype=np.float32)


def ranges(value):
    return np.full((2, 2), value, dtype=np.float32)


def test_a_black_patch_shows_scattered_light_alone():
    seen = attenuate(image(0), ranges(3), BETA, AMBIENT)
    np.testing.assert_allclose(seen[0, 0], AMBIENT * (1 - np.exp(-BETA * 3)), rtol=1e-6)
    assert seen.dtype == np.float32


@given(st.floats(0, 100))
def test_a_white_patch_is_as_bright_as_the_water_at_any_range(distance):
    seen = attenuate(image(1), ranges(distance), BETA, AMBIENT)
    np.testing.assert_allclose(seen[1, 1], AMBIENT, rtol=1e-6)


def test_at_no_range_the_scene_is_itself_and_far_off_there_is_only_water():
    np.testing.assert_allclose(
        attenuate(image(0.3), ranges(0), BETA, AMBIENT)[0, 0], 0.3 * AMBIENT, rtol=1e-6)
    np.testing.assert_allclose(
        attenuate(image(0.3), ranges(np.inf), [0, 0, 1], AMBIENT)[0, 0], AMBIENT, rtol=1e-6)


def test_eight_recovers_what_one_degraded():
    rho = np.random.default_rng(1).random((4, 5, 3), dtype=np.float32)
    distance = np.linspace(1, 5, 20, dtype=np.float32).reshape(4, 5)
    seen = attenuate(rho, distance, BETA, AMBIENT)
    recovered = 1 + (seen / AMBIENT - 1) * np.exp(BETA * distance[..., np.newaxis])
    np.testing.assert_allclose(recovered, rho, atol=2e-5)


def test_ambient_light_falls_exponentially():
    np.testing.assert_allclose(
        ambient_light_at_depth(BETA, 4.0, surface_light=2.0, transmission=0.9),
        1.8 * np.exp(-4 * BETA))
    assert ambient_light_at_depth(BETA, 0.0) == pytest.approx([1, 1, 1])
