# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Light of lamps against closed forms and an adaptive quadrature."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from uw_visibility.compute.threads import Workers
from uw_visibility.config.lighting import beam_falloff
from uw_visibility.errors import InputError
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.lamp_light import direct_light, scatter, seen_from
from uw_visibility_lab.simulation.lamps import Lamp, default_rig
from uw_visibility_lab.simulation.phase_functions import (
    PHASE_FUNCTIONS,
    fournier_forand,
    henyey_greenstein,
    phase_table,
)

CAMERA = StereoCamera(32, 24, 30.0, 0.12)
RAYS = CAMERA.rig.ray_directions((24, 32))
BETA = np.array([0.35, 0.18, 0.12])
ONE = Workers(1)
PHASE = phase_table("henyey-greenstein")
CURVES = {"henyey-greenstein": henyey_greenstein, "fournier-forand": fournier_forand}


def test_a_lamp_at_the_camera_falls_with_the_square_of_range_and_twice_its_path() -> None:
    ranges = np.linspace(0.5, 12.0, 24 * 32, dtype=np.float32).reshape(24, 32)
    reflectance = np.full((24, 32, 3), 0.4, np.float32)
    lamp = Lamp((0.0, 0.0, 0.0), beam_angle=0.0, power=(2.0, 3.0, 4.0))
    direct = reflectance * direct_light(RAYS, ranges, None, (lamp,), BETA)
    constant = direct * ranges[..., None] ** 2 * np.exp(2.0 * BETA * ranges[..., None])
    np.testing.assert_allclose(constant, np.broadcast_to([0.8, 1.2, 1.6], constant.shape), 1e-5)


def test_beam_and_slant() -> None:
    ranges = np.full((24, 32), 2.0, np.float32)
    lamps = (Lamp((0.0, 0.0, 0.0), (0.0, 0.0, 5.0), 40.0, (1.0, 1.0, 1.0)),)
    direct = direct_light(RAYS, ranges, None, lamps, np.zeros(3))
    angle = np.degrees(np.arccos(RAYS[..., 2]))
    # Half the power at half of the full angle; light of a lamp at 2 m is a quarter of that at 1 m.
    np.testing.assert_allclose(direct[..., 1], 0.25 * 0.5 ** ((angle / 20.0) ** 2), rtol=1e-5)
    towards = np.zeros((24, 32, 3), np.float32)
    towards[..., 2] = -1.0
    slanted = direct_light(RAYS, ranges, towards, lamps, np.zeros(3))
    np.testing.assert_allclose(slanted, direct * RAYS[..., 2:3], rtol=1e-5)
    # What faces away is dark.
    assert not direct_light(RAYS, ranges, -towards, lamps, np.zeros(3)).any()


@pytest.mark.parametrize("name", PHASE_FUNCTIONS)
@pytest.mark.parametrize("lamp", [
    Lamp((-0.5, 0.2, 0.0), (0.1, 0.0, 1.0), 60.0),
    Lamp((0.05, 0.0, -0.1), beam_angle=0.0),
    Lamp((1.5, -0.3, 0.4), (-0.5, 0.1, 1.0), 12.0),
    Lamp((0.0, 0.3, 0.0), (0.0, 1.0, 0.2), 160.0),
])
def test_scattered_light_is_the_integral_along_the_ray(lamp: Lamp, name: str) -> None:
    ranges = np.full((24, 32), 3.0, np.float32)
    ranges[:, 16:] = 30.0
    b = np.array([0.2, 0.14, 0.1])
    scattered = scatter(RAYS, ranges, (lamp,), BETA, b, phase_table(name), ONE)
    for row, column in ((0, 0), (12, 15), (12, 16), (23, 31), (4, 20)):
        ray, c = RAYS[row, column], 1

        def integrand(s: float, ray: np.ndarray = ray, c: int = c) -> float:
            offset = s * ray - lamp.position
            r = float(np.linalg.norm(offset))
            angle = math.acos(np.clip(offset @ lamp.axis / r, -1, 1))
            beam = math.exp(-beam_falloff(lamp.beam_angle) * angle**2)
            scattering = math.acos(np.clip(-offset @ ray / r, -1, 1))
            phase = float(CURVES[name](scattering))
            return beam * phase * math.exp(-BETA[c] * (r + s)) / r**2

        nearest = float(np.clip(ray @ lamp.position, 0.0, 2.9))
        expected = math.pi * lamp.power[c] * b[c] * quad(
            integrand, 0.0, float(ranges[row, column]), points=[nearest, nearest + 0.5],
            epsrel=1e-9, limit=500,
        )[0]
        assert scattered[row, column, c] == pytest.approx(
            expected, rel=1e-4, abs=1e-6 * float(scattered.max()))


def test_open_water_is_the_limit_of_far_ranges_and_more_water_scatters_more() -> None:
    before = np.zeros((24, 32, 3), np.float32)
    for distance in (0.3, 1.0, 3.0, 10.0, 100.0, math.inf):
        ranges = np.full((24, 32), distance, np.float32)
        scattered = scatter(RAYS, ranges, default_rig(2), BETA, BETA, PHASE, ONE)
        # Never less than in front of what is nearer; never below 0.
        assert (scattered >= before * (1.0 - 1e-5)).all()
        last, before = before, scattered
    np.testing.assert_allclose(before, last, rtol=1e-4)


def test_a_symmetric_rig_gives_a_symmetric_picture() -> None:
    lamps = (Lamp((-0.4, -0.2, 0.0), (0.2, 0.1, 1.0)), Lamp((0.4, -0.2, 0.0), (-0.2, 0.1, 1.0)))
    ranges = np.tile(np.linspace(1.0, 4.0, 24, dtype=np.float32)[:, None], 32)
    for image in (
        scatter(RAYS, ranges, lamps, BETA, BETA, phase_table("fournier-forand"), ONE),
        direct_light(RAYS, ranges, None, lamps, BETA),
    ):
        np.testing.assert_allclose(image, image[:, ::-1], rtol=1e-4)
        assert not np.allclose(image, image[::-1], rtol=0.1)


def test_the_right_camera_sees_lamps_from_its_own_place() -> None:
    lamp = Lamp((0.5, 0.0, 0.0))
    ranges = np.full((24, 32), 2.0, np.float32)
    moved = Lamp((0.38, 0.0, 0.0))
    images = [
        scatter(RAYS, ranges, seen_from((one,), offset), BETA, BETA, PHASE, ONE)
        for one, offset in ((lamp, 0.12), (moved, 0.0))
    ]
    np.testing.assert_array_equal(*images)


def test_a_lamp_in_the_camera_scatters_without_bound() -> None:
    ranges = np.full((24, 32), 2.0, np.float32)
    lamps = (Lamp((0.0, 0.005, 0.0)),)
    with pytest.raises(InputError, match="of a camera"):
        scatter(RAYS, ranges, lamps, BETA, BETA, PHASE, ONE)
    assert not scatter(RAYS, ranges, lamps, BETA, 0.0 * BETA, PHASE, ONE).any()


@pytest.mark.parametrize("name", PHASE_FUNCTIONS)
def test_phase_functions_spread_all_light(name: str) -> None:
    def share(first: float, last: float) -> float:
        return 2.0 * math.pi * quad(
            lambda a: float(CURVES[name](a)) * math.sin(a), first, last, limit=500)[0]

    # The pole of Fournier and Forand's holds a little of it.
    assert share(1e-9, math.pi) == pytest.approx(1.0, rel=2e-3)
    # Petzold's average particle sends 0.0183 back (Mobley 2002).
    if name == "fournier-forand":
        assert share(math.pi / 2, math.pi) == pytest.approx(0.0183, rel=0.02)
    else:
        cosine = 2.0 * math.pi * quad(
            lambda a: float(CURVES[name](a)) * math.sin(a) * math.cos(a), 0.0, math.pi)[0]
        assert cosine == pytest.approx(0.9, rel=1e-6)
