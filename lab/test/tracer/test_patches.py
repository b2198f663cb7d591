# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The attenuation of a patch's light: its fit, and its limits where it is traced."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility_lab.tracer.patches import PatchScene, slope


def test_the_slope_of_an_exponential_is_its_attenuation() -> None:
    distance = np.array([0.5, 1.0, 2.0, 3.0])
    seen = 0.9 * np.exp(-0.7 * distance)
    ratio, stddev = slope(distance, seen, 0.001 * seen)
    assert ratio == pytest.approx(0.7)
    assert 0.0 < stddev < 0.02


def test_a_curve_that_is_no_exponential_is_less_certain() -> None:
    distance = np.array([0.5, 1.0, 2.0, 3.0])
    straight, bent = np.exp(-distance), np.exp(-distance + 0.1 * distance**2)
    assert slope(distance, bent, 0.001 * bent)[1] > 3.0 * slope(
        distance, straight, 0.001 * straight)[1]


def test_a_patch_is_between_beam_attenuation_and_absorption() -> None:
    pytest.importorskip("mitsuba", reason="needs the lab's extra trace")
    scene = PatchScene("henyey-greenstein", 0.85, threads=1)
    # Without scattering Beer's law is exact; a patch of some pixels scatters next to nothing in.
    value, noise = scene.transmission(0.0, 1.0, 1.0, 2)
    assert value == pytest.approx(np.exp(-1.0), abs=5.0 * noise + 1e-6)
    small, large = (scene.transmission(0.7, size, 1.0, 8)[0] for size in (1e-3, 40.0))
    assert small == pytest.approx(np.exp(-1.0), rel=0.03)
    # All that is scattered ahead arrives: absorption is 0.3, and some light is turned back.
    assert 0.5 < large < np.exp(-0.3)
