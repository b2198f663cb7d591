# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The light model against its closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uw_visibility.compute.jit import njit
from uw_visibility.optics.light_model import (
    attenuate,
    contrast_gain,
    irradiance_of,
    radiance_of,
    transmission,
)

BETA = np.array([0.5, 0.3, 0.2])
AMBIENT = np.array([0.2, 0.6, 0.8])
unit = st.floats(0, 1)


def image(value):
    return np.full((2, 2, 3), value, dtype=np.float32)


def ranges(value):
    return np.full((2, 2), value, dtype=np.float32)


def test_at_no_range_the_scene_is_itself_and_far_off_there_is_only_water():
    np.testing.assert_allclose(
        attenuate(image(0.3), ranges(0), BETA, AMBIENT)[0, 0], 0.3 * AMBIENT, rtol=1e-6)
    np.testing.assert_allclose(
        attenuate(image(0.3), ranges(np.inf), [0, 0, 1], AMBIENT)[0, 0], AMBIENT, rtol=1e-6)


def test_eight_recovers_what_one_degraded():
    rho = np.random.default_rng(1).random((4, 5, 3), dtype=np.float32)
    distance = np.linspace(1, 5, 20, dtype=np.float32).reshape(4, 5)
    seen = attenuate(rho, distance, BETA, AMBIENT)
    assert seen.dtype == np.float32
    recovered = 1 + (seen / AMBIENT - 1) * np.exp(BETA * distance[..., np.newaxis])
    np.testing.assert_allclose(recovered, rho, atol=2e-5)


@given(st.floats(0.02, 2), st.floats(0.1, 3), st.floats(0.1, 1), st.floats(0.1, 1), unit)
def test_what_the_water_added_and_took_is_undone(beta, distance, veil, light, rho):
    """Veil B and light W apart: E = W ρ e^(−βd) + B (1 − e^(−βd))."""
    left = transmission(beta, distance)
    assert left == pytest.approx(np.exp(-beta * distance))
    seen = irradiance_of(rho, left, veil, light)
    assert seen == pytest.approx(light * rho * left + veil * (1 - left))
    gain = contrast_gain(beta, distance)
    assert radiance_of(seen, gain, veil, light) == pytest.approx(rho, abs=1e-9)
    assert irradiance_of(0.0, left, veil, light) == pytest.approx(veil * (1 - left))


def test_an_image_may_have_another_light_than_veil():
    seen = attenuate(image(0.5), ranges(2), BETA, AMBIENT, scene_light=[0.9, 0.8, 0.7])
    left = np.exp(-2 * BETA)
    np.testing.assert_allclose(
        seen[0, 0], 0.5 * np.array([0.9, 0.8, 0.7]) * left + AMBIENT * (1 - left), rtol=1e-6)


def test_kernels_call_the_same_formulas():
    @njit(cache=False)
    def in_kernel(beta, distance, veil, light, rho):
        left = transmission(beta, distance)
        seen = irradiance_of(rho, left, veil, light)
        back = radiance_of(seen, contrast_gain(beta, distance), veil, light)
        return left, seen, back

    values = 0.3, 2.0, 0.5, 0.9, 0.4
    # NumPy's exponential and the kernels' differ in the last bit.
    assert in_kernel(*values) == pytest.approx(in_kernel.py_func(*values), rel=1e-14)
