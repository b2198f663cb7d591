# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Degraded scenes: geometry, filling, and the colour differences that are known for them."""

import cv2
import numpy as np
import pytest
from scenes import KAPPA

from uw_visibility.errors import InputError
from uw_visibility_lab.evaluation.degrade import (
    degrade,
    fill_from_background,
    load_scene,
)

NAN = np.nan


def write_scene(folder, width=30, disparity=60, right_disparity=True):
    folder.mkdir()
    rng = np.random.default_rng(0)
    for name in ("view1", "view5"):
        pixels = rng.integers(0, 256, (20, width, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"{name}.png"), pixels)
    values = np.full((20, width), disparity, dtype=np.uint8)
    values[0, 0] = 0
    cv2.imwrite(str(folder / "disp1.png"), values)
    if right_disparity:
        cv2.imwrite(str(folder / "disp5.png"), values)
    return folder


@pytest.mark.parametrize(("width", "scale"), [(30, 3), (640, 2), (1282, 1)])
def test_the_width_tells_the_scale(tmp_path, width, scale):
    scene = load_scene(write_scene(tmp_path / "scene", width))
    assert scene.rig.focal_length == pytest.approx(3740 / scale)
    assert scene.disparity_left[5, 5] == pytest.approx(60 / scale)
    assert not scene.known[0, 0]
    assert scene.rig.principal_point == ((width - 1) / 2, 9.5)
    # At the image's centre the ray is the optical axis: range is f·B/d.
    centre = scene.rig.range_from_disparity(scene.disparity_left)[9, width // 2]
    assert centre == pytest.approx(3740 * 0.160 / 60, rel=1e-4)


def test_range_is_along_the_line_of_sight(tmp_path):
    scene = load_scene(write_scene(tmp_path / "scene", 1282))
    cx, cy = scene.rig.principal_point
    expected = 3740 * 0.16 / 60 * np.sqrt(1 + (cx / 3740) ** 2 + (cy / 3740) ** 2)
    corner = scene.rig.range_from_disparity(scene.disparity_left)[-1, -1]
    assert corner == pytest.approx(expected, rel=1e-6)


def test_unknown_pixels_take_the_farther_neighbour():
    disparity = np.array(
        [[NAN, 5, NAN, NAN, 9, NAN], [NAN] * 6, [4, 4, 4, NAN, 2, 2]], dtype=np.float32)
    np.testing.assert_array_equal(
        fill_from_background(disparity),
        [[5, 5, 5, 5, 9, 9], [5, 5, 5, 5, 9, 9], [4, 4, 4, 2, 2, 2]])
    with pytest.raises(InputError, match="no known pixel"):
        fill_from_background(np.full((2, 2), NAN, dtype=np.float32))


def test_a_scene_without_right_disparity_gets_the_warped_one(tmp_path):
    folder = write_scene(tmp_path / "scene", right_disparity=False)
    values = np.full((20, 30), 15, np.uint8)
    values[:, 15:20] = 30
    cv2.imwrite(str(folder / "disp1.png"), values)
    scene = load_scene(folder)
    # Of 5 px, with a nearer surface of 10 px in front, and what only the right view shows.
    x = np.arange(30)
    np.testing.assert_array_equal(scene.disparity_right[5], np.where((x >= 5) & (x < 10), 10, 5))
    left, right = scene.degraded(0.2, 2.0, KAPPA)
    assert left.shape == right.shape == (20, 30, 3)


def test_degraded_code_values_are_the_light_model_rounded():
    radiance = np.array([[[0, 128, 255]]], dtype=np.uint8)
    seen = degrade(radiance, np.array([[3.0]], dtype=np.float32), 0.2, 2.0, KAPPA)
    beta = KAPPA + 0.2
    ambient = np.exp(-beta * 2)
    light = ambient * (1 + (radiance / 255 - 1) * np.exp(-beta * 3))
    np.testing.assert_array_equal(seen, np.round(light * 255))


@pytest.mark.parametrize("missing", ["view1.png", "view5.png", "disp1.png"])
def test_a_missing_file_is_named(tmp_path, missing):
    folder = write_scene(tmp_path / "scene")
    (folder / missing).unlink()
    with pytest.raises(InputError, match=missing.partition(".")[0]):
        load_scene(folder)


def test_files_of_different_size_are_refused(tmp_path):
    folder = write_scene(tmp_path / "scene")
    cv2.imwrite(str(folder / "view5.png"), np.zeros((20, 31, 3), dtype=np.uint8))
    with pytest.raises(InputError, match="different size"):
        load_scene(folder)


@pytest.mark.long
def test_colour_differences_of_degraded_scenes_and_of_their_best_recovery(shared_data):
    """The known means over the four scenes at 2 m: 27/31/34, and 2.8/6.8/14.3 for the oracle."""

    def lab(image):
        return cv2.cvtColor(np.clip(image, 0, 1).astype(np.float32), cv2.COLOR_RGB2LAB)

    means = {}
    for alpha in (0.1, 0.2, 0.3):
        differences = []
        for name in ("aloe", "art", "dolls", "moebius"):
            scene = load_scene(shared_data / "middlebury" / name)
            left, _ = scene.degraded(alpha, 2.0, KAPPA)
            truth = lab(scene.left / 255)
            gain = np.exp((KAPPA + alpha) * scene.rig.range_from_disparity(
                fill_from_background(scene.disparity_left))[..., np.newaxis])
            ambient = np.exp(-(KAPPA + alpha) * 2)
            recovered = 1 + (left / 255 / ambient - 1) * gain
            differences.append([
                np.linalg.norm(lab(image) - truth, axis=2).mean()
                for image in (left / 255, recovered)])
        means[alpha] = np.mean(differences, axis=0)
    np.testing.assert_allclose([means[a][0] for a in means], [27, 31, 34], atol=0.6)
    np.testing.assert_allclose([means[a][1] for a in means], [2.8, 7.0, 14.3], atol=0.3)
