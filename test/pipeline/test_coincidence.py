# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Image and ranges of one scene or of two."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from scenes import water_view

from uw_visibility import StereoRig, estimate_water, match
from uw_visibility.pipeline.coincidence import show_one_scene
from uw_visibility.status import Status
from uw_visibility_lab.evaluation.scenes import load_source
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.frame import Renderer
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.water import Water

CLEAR = np.array([0.228, 0.066, 0.025])


@pytest.fixture(scope="module", params=[0, 2])
def rendered(request: pytest.FixtureRequest) -> tuple[Any, Any, StereoRig]:
    """Image of a reef through turbid water, its disparities and its rig."""
    scene = load_source(request.param)
    return scene.degraded(0.2, 2.0, CLEAR)[0], scene.disparity_left, scene.rig


def noise(like: Any, width: float, seed: int) -> Any:
    """Gaussian noise of an image's size, smoothed over some pixels."""
    values = np.random.default_rng(seed).normal(size=like.shape)
    if width:
        values = cv2.GaussianBlur(values, (0, 0), width)
    return np.clip(120 + 30 * values / values.std(), 0, 255).astype(np.uint8)


def unrelated(image: Any, disparity: Any) -> list[tuple[Any, Any]]:
    """Pairs of an image and disparities that do not belong together."""
    height, width = disparity.shape
    shuffled = np.random.default_rng(3).permutation(image.reshape(-1, 3)).reshape(image.shape)
    return [
        (image, disparity[:, ::-1]), (image, disparity[::-1]), (image, disparity[::-1, ::-1]),
        (image, np.roll(disparity, (height // 3, width // 4), (0, 1))),
        (image, np.roll(disparity, (0, width // 2), (0, 1))), (shuffled, disparity),
        *((noise(image, width, seed), disparity) for width in (0.0, 3.0, 8.0) for seed in (0, 1)),
    ]


def test_an_image_and_its_ranges_show_one_scene(rendered: Any) -> None:
    image, disparity, rig = rendered
    assert show_one_scene(image, rig.range_from_disparity(disparity))
    assert show_one_scene(image[..., 1], rig.range_from_disparity(disparity))


def test_matched_ranges_of_a_small_image_belong_to_it() -> None:
    """Their steps are some pixels off the edges, a larger part of a small image."""
    camera = StereoCamera(320, 240, 300.0, 0.12)
    pose = Pose((0.0, 0.0, 1.5), tilt=0.3)
    frame = Renderer(camera).render(reef(3), pose, Water(0.15, 5.0), seed=3)
    disparity = match(frame.left, frame.right, camera.rig).disparity
    assert show_one_scene(frame.left, camera.rig.range_from_disparity(disparity))


def test_ranges_of_something_else_are_told(rendered: Any) -> None:
    image, disparity, rig = rendered
    cases = unrelated(image, disparity)
    taken = [
        number for number, (shown, ranges) in enumerate(cases)
        if show_one_scene(shown, rig.range_from_disparity(np.ascontiguousarray(ranges)))]
    # One in 25 is by chance.
    assert len(taken) <= 1, taken


def test_the_estimate_says_so(rendered: Any) -> None:
    image, disparity, rig = rendered
    assert estimate_water(image, disparity, rig).status is not Status.RANGES_OF_ANOTHER_SCENE
    found = estimate_water(noise(image, 0.0, 0), disparity, rig)
    assert found.status is Status.RANGES_OF_ANOTHER_SCENE
    assert found.reasons["visibility"] == str(Status.RANGES_OF_ANOTHER_SCENE)
    assert np.isnan(found.visibility.distance)


def test_steps_in_one_direction_tell_nothing() -> None:
    """Painted patches on walls side by side: their edges are not those of the walls."""
    view = water_view()
    assert show_one_scene(view.codes(), view.range)
    assert show_one_scene(view.codes(), view.range[:, ::-1].copy())


def test_a_plane_tells_nothing(rendered: Any) -> None:
    image, _, _ = rendered
    plane = np.linspace(6.0, 2.0, image.shape[0], dtype=np.float32)[:, np.newaxis]
    assert show_one_scene(image, np.repeat(plane, image.shape[1], axis=1))
    assert show_one_scene(np.full_like(image, 90), np.repeat(plane, image.shape[1], axis=1))
