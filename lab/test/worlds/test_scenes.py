# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Scenes without water."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.simulation.raycast import meet_ground, nearest_shape
from uw_visibility_lab.simulation.shapes import NOWHERE
from uw_visibility_lab.worlds.geometry import LEVELS, TEXTURE, picture_levels
from uw_visibility_lab.worlds.scenes import (
    _Builder,
    load_scene,
    make_pool,
    middlebury,
    pool,
    procedural,
    read_pictures,
)

SIZE = (60, 80)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> object:
    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(0)
    for k in range(3):
        image = cv2.resize(rng.integers(0, 255, (20, 20, 3)).astype(np.uint8), (300, 280))
        cv2.imwrite(str(folder / f"{k}.png"), image)
    (folder / "notes.txt").write_text("no picture", encoding="utf-8")
    return folder


def test_scenes_are_whole_and_of_many_shapes() -> None:
    spreads, open_water = [], 0
    for seed in range(25):
        scene = procedural(np.random.default_rng(seed), size=SIZE)
        known = np.isfinite(scene.range)
        assert scene.reflectance.shape == (*SIZE, 3) and scene.reflectance.dtype == np.float32
        assert scene.range.shape == SIZE and scene.range.dtype == np.float32
        assert np.isfinite(scene.reflectance).all()
        assert scene.reflectance.min() >= 0.0 and scene.reflectance.max() <= 1.0
        assert not np.isnan(scene.range).any() and (scene.range > 0.0).all()
        assert known.mean() > 0.2
        spreads.append(np.quantile(scene.range[known], 0.95) / np.median(scene.range[known]))
        open_water += not known.all()
    assert np.quantile(spreads, 0.9) > 2.0
    assert 0 < open_water < 25


def test_a_level_floor_is_where_its_rays_say() -> None:
    relief = np.zeros((64, 64))
    for pitch in (0.1, 0.5, math.pi / 2):
        t = meet_ground(
            relief, 12.0, 0.0, 0.5, 0.0, 0.0, 1.0, 0.0, math.cos(pitch), -math.sin(pitch), 0.02,
            40.0)
        assert t == pytest.approx(1.0 / math.sin(pitch), rel=1e-3)
    assert meet_ground(
        relief, 12.0, 0.0, 0.5, 0.0, 0.0, 1.0, 0.0, 1.0, 0.1, 0.02, 40.0) == NOWHERE


@pytest.mark.parametrize(("kind", "half", "range_ahead"), [
    (0, (0.5, 0.7, 0.4), 2.3), (1, (0.2, 0.2, 1.0), 2.8), (2, (0.3, 0.4, 0.5), 2.6)])
def test_shapes_are_met_at_their_surface(kind: int, half: tuple, range_ahead: float) -> None:
    builder = _Builder(np.random.default_rng(0), (), SIZE)
    builder.add(kind, (0.0, 3.0, 1.0), half, 0)
    shapes = np.array(builder.shapes)
    assert nearest_shape(shapes, np.arange(1), 0.0, 0.0, 1.0, 0.0, 1.0, 0.0) == (
        pytest.approx(range_ahead), 0)
    assert nearest_shape(shapes, np.arange(1), 0.0, 0.0, 1.0, 1.0, 0.0, 0.0) == (NOWHERE, -1)


def test_levels_of_a_picture_keep_its_mean() -> None:
    picture = np.random.default_rng(1).random((TEXTURE, TEXTURE, 3), np.float32)
    levels = picture_levels(picture)
    last = (TEXTURE >> LEVELS - 1) ** 2
    assert levels[-last:].mean(0) == pytest.approx(picture.mean((0, 1)), rel=1e-4)


def test_a_pool_is_its_seed(tmp_path: object, pictures: object) -> None:
    for name, count, seed in (("a", 4, 1), ("b", 3, 1), ("c", 3, 2)):
        make_pool(count, seed, tmp_path / name, pictures, SIZE)
    a, b, c = ([load_scene(path) for path in pool(tmp_path / name)] for name in "abc")
    assert len(a) == 4
    for first, again in zip(a, b, strict=False):
        np.testing.assert_array_equal(first.reflectance, again.reflectance)
        np.testing.assert_array_equal(first.range, again.range)
        assert first.name == again.name
    assert not np.array_equal(a[0].range, c[0].range)
    known = np.isfinite(a[0].range)
    assert np.median(a[0].range[known]) == pytest.approx(1.0, rel=2e-3)


def test_a_pool_is_the_same_for_any_number_of_jobs(tmp_path: object, pictures: object) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    make_pool(5, 3, one, pictures, SIZE)
    make_pool(5, 3, two, pictures, SIZE, jobs=2)
    assert [path.name for path in pool(one)] == [path.name for path in sorted(two.iterdir())]
    assert len(pool(one)) == 5
    for first, second in zip(pool(one), pool(two), strict=True):
        assert first.read_bytes() == second.read_bytes()


def test_pictures_are_textures_and_objects_have_their_own(pictures: object) -> None:
    textures = read_pictures(pictures)
    assert len(textures) == 3 and textures[0].shape == (TEXTURE, TEXTURE, 3)
    kinds = {procedural(np.random.default_rng(seed), textures, SIZE).kind for seed in range(20)}
    assert kinds == {"procedural", "picture on a plane"}


def test_folders_without_content_are_refused(tmp_path: object) -> None:
    with pytest.raises(InputError, match="no scene"):
        pool(tmp_path)
    with pytest.raises(InputError, match="no picture"):
        read_pictures(tmp_path)
    with pytest.raises(InputError, match="no folder"):
        read_pictures(tmp_path / "absent")
    with pytest.raises(InputError, match="view1"):
        middlebury(tmp_path)
    (tmp_path / "000000.npz").write_bytes(b"nothing")
    with pytest.raises(InputError, match="000000"):
        load_scene(tmp_path / "000000.npz")


def grey_scene(folder: Path, disparity: np.ndarray) -> Path:
    """Write a scene of Middlebury of one grey, with its disparity in thirds of a pixel."""
    cv2.imwrite(str(folder / "disp1.png"), disparity)
    for name in ("view1.png", "view5.png"):
        cv2.imwrite(str(folder / name), np.full((*disparity.shape, 3), 51, np.uint8))
    return folder


def test_middlebury_scenes_are_filled_and_metric(tmp_path: Path) -> None:
    disparity = np.full((40, 60), 90, np.uint8)
    disparity[:, 30:] = 180
    disparity[:, 26:30] = 0
    scene = middlebury(grey_scene(tmp_path, disparity))
    # f B / d with a third of 3740 px, 0.16 m and 30 px; a hole takes the farther side.
    assert scene.range[20, 27] == pytest.approx(3740 / 3 * 0.16 / 30, rel=1e-3)
    assert scene.range[20, 40] == pytest.approx(3740 / 3 * 0.16 / 60, rel=1e-3)
    assert scene.reflectance == pytest.approx(0.2)


def test_middlebury_rows_without_disparity_are_as_the_nearest_row(tmp_path: Path) -> None:
    disparity = np.full((40, 60), 90, np.uint8)
    disparity[20:] = 180
    disparity[17:20] = 0
    scene = middlebury(grey_scene(tmp_path, disparity))
    expected = 3740 / 3 * 0.16 / np.array([30, 60])
    assert scene.range[[17, 19], 30] == pytest.approx(expected, rel=1e-3)


def test_a_middlebury_scene_without_any_disparity_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no known pixel"):
        middlebury(grey_scene(tmp_path, np.zeros((40, 60), np.uint8)))


def test_recorded_scenes_are_read(shared_data: object) -> None:
    scene = middlebury(shared_data / "middlebury" / "art")
    assert scene.name == "art" and scene.kind == "rgbd"
    assert np.isfinite(scene.range).all()
    assert 3.0 < np.median(scene.range) < 15.0
