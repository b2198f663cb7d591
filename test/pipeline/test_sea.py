# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Real frames of the sea with ranges from structure from motion (FLSea)."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from uw_visibility import StereoRig, estimate_water
from uw_visibility.pipeline.coincidence import show_one_scene
from uw_visibility.pipeline.parts import WaterResult
from uw_visibility.status import Status

FOCAL_LENGTH = 1296.0
BASELINE = 0.1


@pytest.fixture(scope="module")
def frames(shared_data) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return each frame's image and depth, m; 0 where unknown."""
    folder = shared_data / "flsea"
    if not folder.is_dir():
        pytest.skip("the frames of FLSea are absent")
    return {
        path.name.removesuffix("_depth.png"): (
            np.ascontiguousarray(
                cv2.imread(str(path).replace("_depth.png", ".png"))[..., ::-1]),
            cv2.imread(str(path), cv2.IMREAD_UNCHANGED) / np.float32(1000))
        for path in sorted(folder.glob("*_depth.png"))
    }


@pytest.fixture(scope="module")
def sea(shared_data, frames) -> dict[str, tuple[WaterResult, np.ndarray | None]]:
    """Return each frame's result, and the irradiance of its open water where it shows some."""
    open_water = json.loads((shared_data / "flsea" / "open_water.json").read_text())
    results = {}
    for name, (image, depth) in frames.items():
        with np.errstate(divide="ignore"):
            disparity = np.where(depth > 0, FOCAL_LENGTH * BASELINE / depth, np.nan)
        height, width = depth.shape
        rig = StereoRig(FOCAL_LENGTH, BASELINE, ((width - 1) / 2, (height - 1) / 2))
        water = None
        if name in open_water:
            left, top, right, bottom = open_water[name]
            water = image[top:bottom, left:right].mean(axis=(0, 1)) / 255
        results[name] = estimate_water(image, disparity, rig), water
    return results


def test_nothing_is_clearer_than_clear_water(sea):
    for result, _ in sea.values():
        if result.status is Status.OK:
            upper = result.water.attenuation + 3 * result.water.attenuation_stddev
            assert (upper > result.clear_water_attenuation).all()
            # Twice as far as divers see in the clearest seas.
            assert not result.visibility.distance > 120


def test_frames_with_open_water_are_assessed(sea):
    shown = [(result, water) for result, water in sea.values() if water is not None]
    assessed = [result.visibility.status is Status.OK for result, _ in shown]
    assert sum(assessed) >= 0.8 * len(shown)
    for result, water in shown:
        off = np.abs(result.water.veil - water) - 0.25 * water - 2 / 255
        assert (off < 3.0 * result.water.ambient_light_stddev).all()


def test_frames_belong_to_their_ranges_and_not_to_those_of_others(frames):
    for image, ranges in frames.values():
        assert show_one_scene(image, ranges)
        assert not show_one_scene(image, np.ascontiguousarray(ranges[::-1, ::-1]))
        noise = np.random.default_rng(1).normal(100, 30, image.shape)
        assert not show_one_scene(np.clip(noise, 0, 255).astype(np.uint8), ranges)
