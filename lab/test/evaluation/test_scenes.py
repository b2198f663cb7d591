# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Scenes are found in folders, or rendered with a disparity that fits their images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.evaluation.scenes import (
    find_scenes,
    load_source,
    render_scene,
    search_limit,
    tolerance,
)
from uw_visibility_lab.simulation.camera import StereoCamera

CAMERA = StereoCamera(160, 120, 150.0, 0.12)


def test_a_scene_and_a_folder_of_scenes_are_both_datasets(scene_folder):
    (alone,), (among,) = find_scenes([scene_folder]), find_scenes([scene_folder.parent])
    assert alone == among
    scene = load_source(alone)
    assert scene.name == scene_folder.name
    assert tolerance(scene) == 1.0
    largest = np.nanmax(scene.disparity_left)
    assert search_limit(scene) % 16 == 0
    assert search_limit(scene) - 16 <= largest < search_limit(scene)


def test_without_dataset_scenes_are_rendered():
    sources = find_scenes([])
    assert len(set(sources)) == len(sources) >= 2
    assert all(isinstance(source, int) for source in sources)


def test_a_relative_folder_has_its_name(scene_folder, monkeypatch):
    monkeypatch.chdir(scene_folder)
    (source,) = find_scenes([Path()])
    assert source == scene_folder.resolve()


def test_the_same_name_twice_is_refused(scene_folder):
    with pytest.raises(InputError, match="two scenes"):
        find_scenes([scene_folder, scene_folder])


def test_rendered_disparities_take_the_right_image_to_the_left_one():
    scene = render_scene(3, CAMERA)
    assert scene.name == "reef3"
    row, column = np.nonzero(scene.known)
    target = np.round(column - scene.disparity_left[row, column]).astype(int)
    inside = target >= 0
    # What the right view hides has another disparity there.
    same = inside.copy()
    same[inside] = np.abs(
        scene.disparity_right[row[inside], target[inside]]
        - scene.disparity_left[row[inside], column[inside]]) < 0.5
    difference = np.abs(
        scene.left[row[same], column[same]].astype(float)
        - scene.right[row[same], target[same]])
    elsewhere = np.abs(scene.left[row[same], column[same]].astype(float)
                       - scene.right[row[same], column[same]])
    assert same.mean() > 0.7
    assert difference.mean() < 0.3 * elsewhere.mean()


def test_a_seed_gives_the_same_scene_again():
    first, again, other = (render_scene(seed, CAMERA) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.left, again.left)
    assert not np.array_equal(first.left, other.left)
