# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The same ground is found in frames that see it from elsewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes import flat_floor

from uw_visibility_lab.evaluation.lamps.survey import (
    CELL,
    HALF_WIDTH,
    GroundCells,
    ground_cells,
    pose_of,
)
from uw_visibility_lab.simulation.camera import NOISELESS, Pose, StereoCamera
from uw_visibility_lab.simulation.frame import Renderer
from uw_visibility_lab.simulation.water import Water

CAMERA = StereoCamera(160, 120, 150.0, 0.12)
LENGTH = 2.0
RENDERER = Renderer(CAMERA, NOISELESS)
POSES = [
    Pose((1.0 + 0.1 * math.sin(k), 0.1 * math.cos(3 * k), 1.5 + 0.1 * k), heading=0.6 * k,
         tilt=math.pi / 2 - 0.02 * k)
    for k in range(10)
]


@pytest.fixture(scope="module")
def seen() -> tuple[list[np.ndarray], list[np.ndarray]]:
    floor = flat_floor(seed=2)
    frames = [RENDERER.render(floor, pose, Water(0.0, 0.0)) for pose in POSES]
    cells = [
        ground_cells(frame.range_left, CAMERA, pose, LENGTH)
        for frame, pose in zip(frames, POSES, strict=True)
    ]
    return [frame.radiance_left for frame in frames], cells


def test_a_point_of_the_floor_has_its_number_in_every_frame(seen) -> None:
    _, cells = seen
    point = np.array([1.13, 0.07, 0.0])
    expected = (int(point[1] // CELL) + round(HALF_WIDTH / CELL)) * round(LENGTH / CELL) + int(
        point[0] // CELL)
    for pose, numbers in zip(POSES, cells, strict=True):
        x, y, z = (point - pose.position) @ pose.rotation()
        column, row = round(150.0 * x / z + 79.5), round(150.0 * y / z + 59.5)
        assert numbers[row, column] == expected


def test_ground_that_a_frame_cuts_off_does_not_count(seen) -> None:
    _, cells = seen
    for numbers, pose in zip(cells, POSES, strict=True):
        count = np.bincount(numbers[numbers >= 0])
        level = (CELL * 150.0 / pose.position[2]) ** 2
        assert count[count > 0].min() > 0.75 * level


def test_variation_is_what_light_makes_of_it(seen) -> None:
    truth, cells = seen
    ground = GroundCells.of(truth, cells)
    assert ground.count > 20
    assert ground.views >= 8
    assert (ground.variation(truth) < 0.02).all()
    gains = np.array([0.8, 1.2] * 5)
    flicker = [np.float32(gain) * image for gain, image in zip(gains, truth, strict=True)]
    np.testing.assert_allclose(ground.variation(flicker), 0.2, atol=0.02)
    # A channel by itself.
    red = [image * np.array([gain, 1, 1]) for gain, image in zip(gains, truth, strict=True)]
    np.testing.assert_allclose(ground.variation(red), [0.2, 0.0, 0.0], atol=0.02)


def test_a_survey_sees_its_ground_from_several_heights_and_sides() -> None:
    poses = [pose_of(k, 100) for k in range(100)]
    over = [p for p in poses if abs(p.position[0] - 1.5) < 0.3]
    assert np.ptp([p.position[2] for p in over]) > 1.0
    assert {round(math.cos(p.heading)) for p in over} == {-1, 1}
    assert {p.position[1] for p in over} == {-0.2, 0.2}
