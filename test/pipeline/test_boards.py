# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Disparity of flat boards on real pairs under water, as they are and with more noise."""

import json

import cv2
import numpy as np
import pytest

from uw_visibility import Pipeline
from uw_visibility.commands.calibration_file import read_rig
from uw_visibility.images.files import read_image
from uw_visibility.status import Status
from uw_visibility_lab.evaluation.metrics import correct_fraction


@pytest.mark.parametrize(("name", "codes", "least"), [
    ("bermuda", 0.0, 0.99), ("tank", 2.0, 0.88),
])
def test_boards_are_flat(shared_data, name, codes, least):
    folder = shared_data / "underwater" / name
    rig, _ = read_rig([folder / "calibration.json"])
    pipeline = Pipeline(rig)
    correct = []
    for number, board in json.loads((folder / "board_planes.json").read_text()).items():
        rng = np.random.default_rng(int(number))
        pair = [read_image(folder / f"{side}_{number}.png") for side in ("left", "right")]
        noisy = [np.clip(i + codes * rng.standard_normal(i.shape) + 0.5, 0, 255) for i in pair]
        images = noisy if codes else pair
        disparity = pipeline.process(*(i.astype(np.uint8) for i in images), enhance=()).disparity
        a, b, c = board["disparity_plane_abc"]
        y, x = np.indices(disparity.shape)
        inside = np.zeros(disparity.shape, np.uint8)
        cv2.fillConvexPoly(inside, np.round(board["corners_left_rect"]).astype(np.int32), 1)
        plane = np.where(inside > 0, a * x + b * y + c, np.nan).astype(np.float32)
        correct.append(correct_fraction(disparity, plane))
    assert np.mean(correct) >= least, correct


@pytest.mark.parametrize(("name", "left", "right"), [
    ("bermuda", "08", "04"), ("bermuda", "10", "25"), ("bermuda", "17", "04"),
])
def test_images_of_different_times_tell_no_water(shared_data, name, left, right):
    """As of cameras that are not triggered together: many of the chance matches are consistent."""
    folder = shared_data / "underwater" / name
    rig, _ = read_rig([folder / "calibration.json"])
    pair = [read_image(folder / f"{side}.png") for side in (f"left_{left}", f"right_{right}")]
    result = Pipeline(rig).process(*pair, enhance=())
    assert result.status is Status.TOO_FEW_SUPPORT_POINTS
    assert result.stereo.support_points > 100
    assert np.isnan(result.water.attenuation).all()


@pytest.mark.parametrize(("name", "number"), [("bermuda", "25"), ("tank", "05")])
def test_a_board_by_day_is_not_taken_for_one_by_lamps(shared_data, name, number):
    folder = shared_data / "underwater" / name
    rig, _ = read_rig([folder / "calibration.json"])
    pair = [read_image(folder / f"{side}_{number}.png") for side in ("left", "right")]
    result = Pipeline(rig).process(*pair, enhance=())
    assert Status.LIT_BY_LAMPS not in (result.water.status, result.coarse_water.status)
