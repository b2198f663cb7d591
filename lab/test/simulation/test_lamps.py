# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames and recordings under lamps: what is lit, when, and the truth beside it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import flat_floor

from uw_visibility.cli import main
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility_lab.simulation.camera import NOISELESS, Pose, StereoCamera
from uw_visibility_lab.simulation.frame import Effects, Renderer
from uw_visibility_lab.simulation.lamps import Lamp, Lighting, default_rig, misplaced
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.transect import Transect
from uw_visibility_lab.simulation.water import Water, WaterEffects

CAMERA = StereoCamera(80, 60, 75.0, 0.12)
ABOVE = Pose((0.0, 0.0, 2.0), tilt=math.pi / 2)
WATER = Water(0.1, 12.0, 1.2)
NIGHT = Lighting(default_rig(2), daylight=False)
RENDERER = Renderer(CAMERA, NOISELESS, lighting=NIGHT)
GREY = flat_floor(texture=0.0)


def test_a_night_frame_is_direct_light_and_scattered_light() -> None:
    unscattered = Renderer(
        CAMERA, NOISELESS, lighting=replace(NIGHT, scattering_albedo=(0.0, 0.0, 0.0)))
    frame, direct = (r.render(GREY, ABOVE, WATER) for r in (RENDERER, unscattered))
    assert (frame.left >= direct.left).all()
    assert (frame.left > direct.left).mean() > 0.5
    # The closed form at the middle of the left image: a floor of one colour, 2 m below.
    colour = frame.radiance_left[30, 40]
    beta = WATER.attenuation()
    expected = np.zeros(3)
    for lamp in NIGHT.lamps:
        offset = np.array([0.0, 0.0, 2.0]) - lamp.position
        r = float(np.linalg.norm(offset))
        angle = math.acos(offset @ lamp.axis / r)
        light = 2.0 ** -((2.0 * angle / math.radians(lamp.beam_angle)) ** 2)
        expected += colour * np.array(lamp.power) * light * (offset[2] / r) / r**2 * np.exp(
            -beta * (r + 2.0))
    measured = direct.left[29:31, 39:41].reshape(-1, 3).mean(axis=0) / 255.0
    np.testing.assert_allclose(measured, 1.2 * expected, atol=1.0 / 255.0)
    # Truth: reflectance without shade, lamps as the image shows them, no daylight.
    np.testing.assert_allclose(frame.radiance_left, np.broadcast_to(colour, (60, 80, 3)))
    assert frame.lamps[1].position == NIGHT.lamps[1].position
    np.testing.assert_allclose(frame.lamps[0].power, 1.2 * np.array(NIGHT.lamps[0].power))
    assert not frame.ambient_light.any()
    assert not frame.scene_light.any()
    np.testing.assert_array_equal(frame.attenuation, beta)


def test_daylight_and_lamps_add_up() -> None:
    day = Renderer(CAMERA, NOISELESS).render(GREY, ABOVE, WATER)
    both = Renderer(CAMERA, NOISELESS, lighting=replace(NIGHT, daylight=True)).render(
        GREY, ABOVE, WATER)
    night = RENDERER.render(GREY, ABOVE, WATER)
    np.testing.assert_allclose(
        both.left.astype(float), day.left.astype(float) + night.left, atol=1.0)
    np.testing.assert_array_equal(both.ambient_light, day.ambient_light)


def test_both_cameras_see_the_same_light_on_the_floor() -> None:
    """What falls on a floor does not depend on the camera; only ways back differ a little."""
    unscattered = Renderer(
        CAMERA, NOISELESS, lighting=replace(NIGHT, scattering_albedo=(0.0, 0.0, 0.0)))
    frame = unscattered.render(GREY, ABOVE, Water(0.0, 5.0, 1.2))
    shift = round(75.0 * 0.12 / 2.0)
    left, right = frame.left[:, shift + 1:].astype(float), frame.right[:, :-shift - 1].astype(float)
    assert np.abs(left - right).max() <= 3.0


@pytest.mark.parametrize("lighting", [NIGHT, replace(NIGHT, daylight=True)])
def test_automatic_exposure_suits_the_camera(lighting: Lighting) -> None:
    frame = Renderer(CAMERA, lighting=lighting).render(
        reef(5, 2.0), Pose((0.0, 0.0, 1.5), tilt=0.28), Water(0.1, 8.0))
    assert 0.7 * 255 < np.percentile(frame.left.max(axis=2), 99) < 0.9 * 255


def test_snow_is_bright_near_the_lamps_and_dark_at_night_without() -> None:
    lamp = Lamp((-0.3, 0.0, 0.2), (0.5, 0.0, 1.0), 60.0)
    lighting = Lighting((lamp,), daylight=False, scattering_albedo=(0.0, 0.0, 0.0))
    clear, snowy = (
        Renderer(CAMERA, NOISELESS, Effects(marine_snow=share), lighting=lighting).render(
            GREY, ABOVE, WATER).left.astype(float).sum(axis=2)
        for share in (0.0, 0.3)
    )
    added = snowy - clear
    assert added[:, :40].sum() > 1.5 * added[:, 40:].sum() > 0.0
    unlit = Renderer(
        CAMERA, NOISELESS, Effects(marine_snow=0.3), lighting=replace(lighting, strobe="alternate"))
    assert not unlit.render(GREY, ABOVE, WATER, index=1).left.any()


def test_strobes_fire_with_their_frames() -> None:
    lighting = replace(NIGHT, daylight=True, strobe="alternate", jitter=0.2)
    transect = Transect(
        frames=4, camera=CAMERA, sensor=NOISELESS, lighting=lighting, attenuation=(0.1, 0.1),
        depth=(15.0, 15.0))
    frames = [frame for _, frame in transect.render()]
    assert [len(frame.lamps) for frame in frames] == [2, 0, 2, 0]
    # Of daylight nearly no red is left.
    assert frames[0].left[..., 0].mean() > 1.5 * frames[1].left[..., 0].mean()
    powers = np.array([lamp.power[1] for k in (0, 2) for lamp in frames[k].lamps])
    assert 0.02 < np.log(powers).std() < 0.8
    assert len(set(powers)) == 4
    # One exposure for all: daylight is as bright in each.
    np.testing.assert_allclose(frames[0].ambient_light, frames[3].ambient_light)


def test_a_survey_looks_down_from_changing_altitude() -> None:
    transect = Transect(
        frames=3, rate=1 / 8.0, speed=0.0, camera=CAMERA, tilt=90.0, altitude=(1.5, 3.0),
        lighting=NIGHT)
    middle = [float(np.median(frame.range_left)) for _, frame in transect.render()]
    # Up and down once in 16 s, over relief.
    assert middle[1] - middle[0] == pytest.approx(1.5, abs=0.25)
    assert middle[2] == pytest.approx(middle[0], abs=0.2)


def test_misplaced_lamps_are_off_by_as_much() -> None:
    lamps = default_rig(4)
    wrong = misplaced(lamps, 0.05, 5.0, seed=1)
    for one, other in zip(lamps, wrong, strict=True):
        assert math.dist(one.position, other.position) == pytest.approx(0.05)
        assert math.degrees(math.acos(one.axis @ other.axis)) == pytest.approx(5.0)
    assert wrong != misplaced(lamps, 0.05, 5.0, seed=2)


@pytest.mark.parametrize(("make", "what"), [
    (lambda: Lamp((0.0, 0.0, math.nan)), "position"),
    (lambda: Lamp((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), "direction"),
    (lambda: Lamp((1.0, 0.0, 0.0), beam_angle=3.0), "beam"),
    (lambda: Lamp((1.0, 0.0, 0.0), power=(-1.0, 1.0, 1.0)), "power"),
    (lambda: Lighting(daylight=False), "neither"),
    (lambda: Lighting(scattering_albedo=(0.5, 0.5, 1.5)), "albedo"),
    (lambda: Lighting(phase_function="mie"), "phase function"),
    (lambda: Lighting(strobe="sometimes"), "strobe"),
    (lambda: Lighting(jitter=-0.1), "jitter"),
    (lambda: default_rig(3), "number of lamps"),
    (lambda: RENDERER.render(
        GREY, ABOVE, Water(0.1, 3.0, None, WaterEffects(water_type="II"))), "leave out the lamps"),
    (lambda: Transect(altitude=(0.1, 3.0)), "altitude"),
])
def test_what_lights_nothing_is_refused(make: Any, what: str) -> None:
    with pytest.raises(InputError, match=what):
        make()


SMALL = ["--frames", "2", "--width", "96", "--height", "64", "--attenuation", "0.1", "0.1"]


def test_the_command_records_lamps_and_their_truth(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from uw_visibility.messages.images import read_image
    from uw_visibility.replay.bags.reader import BagReader

    path = tmp_path / "bag"
    options = "--lamps 2 --night --downward --altitude 1.5 3 --lamp-beam 60 --lamp-power 1 1 0.5"
    assert main(["simulate", "-o", str(path), *SMALL, *options.split()]) == 0
    found: dict[str, Any] = {}
    with BagReader(path) as reader:
        for recorded in reader.messages():
            found.setdefault(recorded.topic, reader.deserialize(recorded))
    message = found["/ground_truth/lamps"]
    rows = message.data.reshape([dimension.size for dimension in message.layout.dim])
    np.testing.assert_allclose(rows[:, :3], [lamp.position for lamp in default_rig(2)])
    assert (rows[:, 6] == 60.0).all()
    np.testing.assert_allclose(rows[:, 7] / rows[:, 9], 2.0)
    reflectance = read_image(found["/ground_truth/reflectance"])
    # The floor fills the view, some of it bright, some dark; light falls off, this does not.
    assert reflectance.std() > 30.0
    assert reflectance.max() > 200
    vector = found["/ground_truth/ambient_light"].vector
    assert (vector.x, vector.y, vector.z) == (0.0, 0.0, 0.0)
    told = PipelineConfig.from_yaml(path / "lighting.yaml").lighting
    assert told.model == "lamps"
    for lamp, row in zip(told.lamps(), rows, strict=True):
        np.testing.assert_allclose([*lamp.position, *lamp.direction, lamp.beam_angle], row[:7])
        np.testing.assert_allclose(lamp.colour, [1.0, 1.0, 0.5])
