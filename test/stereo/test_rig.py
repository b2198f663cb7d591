# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Geometry of the rig against closed forms, and rectification against OpenCV and recordings."""

from __future__ import annotations

import json
import math
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plain_messages import camera_info as make_info
from plain_messages import region as roi

from uw_visibility.errors import InputError
from uw_visibility.stereo.calibration import CameraCalibration, doubt
from uw_visibility.stereo.rectification import Rectifier
from uw_visibility.stereo.rig import StereoRig

FOCAL, BASELINE, CENTRE = 400.0, 0.12, (31.5, 23.5)
SIZE = (64, 48)


def camera_info(tx: float = 0.0, cx: float = CENTRE[0], **changes: Any) -> SimpleNamespace:
    """Make the CameraInfo of a camera of the pair; cx is that of P."""
    p = [FOCAL, 0.0, cx, tx, 0.0, FOCAL, CENTRE[1], 0.0, 0.0, 0.0, 1.0, 0.0]
    return make_info(SIZE, FOCAL, CENTRE, **({"p": p} | changes))


def right_info(**changes: Any) -> SimpleNamespace:
    return camera_info(tx=-FOCAL * BASELINE, **changes)


def test_range_is_depth_times_the_length_of_the_ray() -> None:
    rig = StereoRig(FOCAL, BASELINE, CENTRE, (CENTRE[0] - 3.0, CENTRE[1]))
    disparity = np.full((48, 64), 23.0, np.float32)
    depth = FOCAL * BASELINE / (23.0 - 3.0)
    ray = math.sqrt(1 + ((60 - CENTRE[0]) / FOCAL) ** 2 + ((5 - CENTRE[1]) / FOCAL) ** 2)
    result = rig.range_from_disparity(disparity)
    assert result.dtype == np.float32
    assert result[5, 60] == pytest.approx(depth * ray, rel=1e-6)


def test_pixels_that_are_not_square_have_rays_of_their_own() -> None:
    rig = StereoRig(FOCAL, BASELINE, CENTRE, focal_length_y=200.0)
    expected = math.sqrt(1 + (CENTRE[0] / FOCAL) ** 2 + (CENTRE[1] / 200.0) ** 2)
    assert rig.ray_lengths((48, 64))[0, 0] == pytest.approx(expected, rel=1e-6)


def test_directions_of_rays_are_those_of_their_pixels() -> None:
    rig = StereoRig(FOCAL, BASELINE, CENTRE, focal_length_y=200.0)
    rays = rig.ray_directions((48, 64))
    np.testing.assert_allclose(np.linalg.norm(rays, axis=2), 1.0)
    np.testing.assert_allclose(1 / rays[..., 2], rig.ray_lengths((48, 64)), rtol=1e-6)
    right, down, forward = rays[5, 60]
    assert (right / forward, down / forward) == pytest.approx(
        ((60 - CENTRE[0]) / FOCAL, (5 - CENTRE[1]) / 200.0))


def test_calibrations_that_are_gone_keep_no_memory() -> None:
    shape = (240, 320)
    tracemalloc.start()
    for number in range(20):
        StereoRig(FOCAL + number, BASELINE, CENTRE).ray_lengths(shape)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # A map for the whole image, and for what the two steps match.
    assert kept < 4 * 4 * shape[0] * shape[1]


@given(
    st.floats(1.0, 500.0), st.floats(-50.0, 50.0), st.integers(0, 47), st.integers(0, 63),
)
def test_disparity_to_range_and_back(corrected: float, offset: float, row: int, col: int) -> None:
    rig = StereoRig(FOCAL, BASELINE, CENTRE, (CENTRE[0] - offset, CENTRE[1]))
    disparity = np.full((48, 64), corrected + offset, np.float32)
    back = rig.disparity_from_range(rig.range_from_disparity(disparity))
    assert back[row, col] == pytest.approx(disparity[row, col], abs=1e-3, rel=1e-5)


def test_what_has_no_range_is_nan_and_the_input_stays() -> None:
    rig = StereoRig(FOCAL, BASELINE, CENTRE, (CENTRE[0] - 2.0, CENTRE[1]))
    disparity = np.array([[np.nan, -1.0, 2.0, 1.9, 3.0]], np.float32)
    before = disparity.copy()
    result = rig.range_from_disparity(disparity)
    assert np.isnan(result).tolist() == [[True, True, True, True, False]]
    np.testing.assert_array_equal(disparity, before)
    back = rig.disparity_from_range(np.array([[np.nan, 0.0, -1.0, np.inf]], np.float32))
    assert np.isnan(back).tolist() == [[True, True, True, False]]
    assert back[0, 3] == rig.offset


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_lengths_that_are_not_positive_are_named(value: float) -> None:
    with pytest.raises(InputError, match=r"focal length is .* positive"):
        StereoRig(value, BASELINE, CENTRE)
    with pytest.raises(InputError, match=r"baseline is .* positive"):
        StereoRig(FOCAL, value, CENTRE)


def test_principal_point_must_be_two_finite_numbers() -> None:
    with pytest.raises(InputError, match="principal point"):
        StereoRig(FOCAL, BASELINE, (math.nan, 1.0))


@pytest.mark.parametrize("value", ["wide", np.ones(3), None, True, np.True_, [0.1], 1j])
@pytest.mark.parametrize(
    "name", ["focal_length", "baseline", "principal_point", "principal_point_right"])
def test_what_is_no_number_is_named(name: str, value: Any) -> None:
    arguments: dict[str, Any] = {
        "focal_length": 400.0, "baseline": 0.12, "principal_point": (80.0, 60.0)}
    if name == "principal_point_right" and value is None:
        return  # None means that of the left image
    with pytest.raises(InputError, match=r"(focal length|baseline|principal point) is .*: give"):
        StereoRig(**arguments | {name: value})


@pytest.mark.parametrize("focal_length, width", [(3.6, 640), (8.0, 320), (12.0, 4000)])
def test_a_focal_length_in_millimetres_is_told_as_such(focal_length: float, width: int) -> None:
    says = f"focal length is {focal_length:g} px, probably {focal_length:g} mm: give it in px"
    with pytest.raises(InputError, match=says):
        StereoRig(focal_length, 0.1, ((width - 1) / 2, 100.0))
    # A wide lens has a fourth of the width.
    StereoRig(width / 4, 0.1, ((width - 1) / 2, 100.0))


def test_a_baseline_in_millimetres_is_told_as_such() -> None:
    with pytest.raises(InputError, match="baseline is 65 m, probably 65 mm: give it in m"):
        StereoRig(focal_length=400.0, baseline=65.0, principal_point=(80.0, 60.0))


def test_camera_info_of_ros2_and_ros1_give_the_same_rig() -> None:
    left, right = camera_info(), right_info(cx=CENTRE[0] - 4.0)
    rig = StereoRig.from_camera_info(left, right)
    assert rig.baseline == pytest.approx(BASELINE)
    assert (rig.focal_length, rig.principal_point, rig.offset) == (FOCAL, CENTRE, 4.0)
    for info in (left, right):
        for name in "kdrp":
            setattr(info, name.upper(), getattr(info, name))
            delattr(info, name)
    assert StereoRig.from_camera_info(left, right) == rig


def test_region_of_interest_and_binning_move_the_calibration() -> None:
    window = {"roi": roi(10, 8, 40, 32), "binning_x": 2, "binning_y": 2}
    rig = StereoRig.from_camera_info(camera_info(**window), right_info(**window))
    assert rig.baseline == pytest.approx(BASELINE)
    assert rig.focal_length == FOCAL / 2
    assert rig.principal_point == ((CENTRE[0] - 10) / 2, (CENTRE[1] - 8) / 2)
    assert Rectifier(camera_info(**window), right_info(**window)).size == (20, 16)


@pytest.mark.parametrize(("left", "right", "message"), [
    (camera_info(k=[0.0] * 9), right_info(), "left camera_info is not calibrated, K"),
    (camera_info(), right_info(p=[0.0] * 12), "right camera_info is not calibrated, P"),
    (camera_info(k=[math.nan] * 9), right_info(), "left camera_info has K .* not finite"),
    (camera_info(), right_info(width=32), "differ in size, 64x48 and 32x48"),
    (camera_info(width=0, height=0), right_info(), "left camera_info has width 0"),
    (right_info(), camera_info(), "are left and right swapped"),
    (camera_info(), camera_info(tx=48.0), "are left and right swapped"),
    (camera_info(tx=5.0), right_info(), "of the left camera is 5"),
    (camera_info(), camera_info(), "baseline is 0"),
    (camera_info(), right_info(roi=roi(0, 8, 64, 48)), "not rectified"),
    (
        camera_info(),
        right_info(p=[2 * FOCAL, 0, 0, -48.0, 0, 2 * FOCAL, CENTRE[1], 0, 0, 0, 1, 0]),
        "not rectified",
    ),
    (
        camera_info(),
        right_info(p=[FOCAL, 0, CENTRE[0], -1.0, 0, FOCAL, CENTRE[1], -48.0, 0, 0, 1, 0]),
        "vertical pair",
    ),
    (
        camera_info(),
        right_info(p=[FOCAL, 0, CENTRE[0], 0, 0, FOCAL, CENTRE[1], -48.0, 0, 0, 1, 0]),
        "vertical pair",
    ),
    # The baseline itself in the place of the focal length times it.
    (camera_info(), camera_info(tx=-0.12), r"too small for two cameras: .* P\[0, 3\]"),
])
def test_calibrations_that_cannot_be_used_are_named(left: Any, right: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        StereoRig.from_camera_info(left, right)


@pytest.mark.parametrize(("changes", "doubted"), [
    ({}, False),
    # Of images that are halved, and doubled.
    ({"width": 32, "height": 24}, True),
    ({"width": 160, "height": 120}, True),
    ({"binning_x": 2, "binning_y": 2}, False),
    ({"height": 16}, False),
    ({"roi": roi(32, 24, 32, 24)}, False),
])
def test_a_calibration_of_images_of_another_size_is_doubted(
    changes: dict[str, Any], doubted: bool
) -> None:
    info = camera_info(**changes)
    calibration = CameraCalibration.from_camera_info(info, "left")
    assert bool(doubt(info, calibration, "left")) is doubted
    if doubted:
        assert f"left camera_info has the principal point 31.5 23.5, far from the middle of " \
            f"{info.width}x{info.height} pixels" in doubt(info, calibration, "left")


def test_projection_matrices_of_another_form_are_refused() -> None:
    with pytest.raises(InputError, match="3 by 4"):
        StereoRig.from_projection(np.eye(3), np.eye(3))


DISTORTED = [
    ("plumb_bob", [-0.2, 0.05, 1e-3, -2e-3, 0.01]),
    ("rational_polynomial", [0.3, -0.1, 1e-3, -1e-3, 0.02, 0.5, -0.05, 0.01]),
    ("equidistant", [0.05, -0.01, 2e-3, 0.0]),
    ("equidistant", [0.0] * 4),
]


@pytest.mark.parametrize(("model", "coefficients"), DISTORTED)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_rectified_pixels_come_from_where_the_camera_model_puts_them(
    model: str, coefficients: list[float], dtype: type
) -> None:
    k = np.array([[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1.0]])
    rotation = cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))[0]
    changes = {
        "k": k.ravel(), "r": rotation.ravel(), "d": coefficients, "distortion_model": model,
        "p": [60.0, 0, 31.5, 0, 0, 60.0, 23.5, 0, 0, 0, 1, 0],
    }
    left = camera_info(**changes)
    right = camera_info(**(changes | {"p": [60.0, 0, 31.5, -6.0, 0, 60, 23.5, 0, 0, 0, 1, 0]}))
    # The raw image holds its own column, and row, as its values.
    scale = np.iinfo(dtype).max // 64
    columns, rows = np.meshgrid(np.arange(64), np.arange(48))
    raw = (np.dstack([columns, rows, columns]) * scale).astype(dtype)
    rectified = Rectifier(left, right).rectify(raw, raw)[0].astype(float) / scale

    pixel = np.array([40.0, 30.0])
    ray = rotation.T @ np.array([(pixel[0] - 31.5) / 60, (pixel[1] - 23.5) / 60, 1.0])
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    source = project(
        ray.reshape(1, 1, 3), np.zeros(3), np.zeros(3), k, np.array(coefficients))[0].ravel()
    # Half a step of 8 bit, and 1/32 px of the fixed-point maps.
    np.testing.assert_allclose(rectified[30, 40, :2], source, atol=0.5 / scale + 1 / 32 + 1e-3)


@pytest.mark.parametrize("factor", [2, 3])
def test_reduced_image_is_rectified_as_the_whole_one(factor: int) -> None:
    rotation = cv2.Rodrigues(np.array([0.02, -0.03, 0.05]))[0]
    changes = {
        "k": [60.0, 0, 30.5, 0, 60.0, 24.5, 0, 0, 1], "r": rotation.ravel(),
        "d": [-0.2, 0.05, 0.0, 0.0, 0.0], "p": [60.0, 0, 31.5, 0, 0, 60.0, 23.5, 0, 0, 0, 1, 0],
    }
    right = camera_info(**(changes | {"p": [60.0, 0, 31.5, -6.0, 0, 60, 23.5, 0, 0, 0, 1, 0]}))
    rectifier = Rectifier(camera_info(**changes), right)
    y, x = np.mgrid[:48, :64]
    raw = np.dstack([300 * x, 400 * y, 100 * (x + y)]).astype(np.uint16)

    def reduced(image: np.ndarray) -> np.ndarray:
        size = image.shape[1] // factor, image.shape[0] // factor
        whole = image[: size[1] * factor, : size[0] * factor]
        return cv2.resize(whole, size, interpolation=cv2.INTER_AREA)

    expected = reduced(rectifier.rectify(raw, raw)[0])
    whole = reduced(255 * rectifier.valid.astype(np.uint8)) == 255
    inside = np.zeros_like(whole)
    # Squares of the raw image are incomplete near the border.
    inside[4:-4, 4:-4] = whole[4:-4, 4:-4]
    assert inside.sum() > 50
    for _ in range(2):
        found = rectifier.rectify_reduced(reduced(raw), factor)
        # A sixteenth of a pixel: both maps are fixed-point ones.
        np.testing.assert_allclose(
            found[inside].astype(float), expected[inside], atol=400 / 16 * factor
        )


def test_valid_window_holds_what_the_raw_image_reaches() -> None:
    rotation = cv2.Rodrigues(np.array([0.0, 20 / FOCAL, 0.0]))[0]
    rectifier = Rectifier(
        camera_info(r=rotation.ravel()), right_info(r=rotation.ravel())
    )
    white = np.full((48, 64), 255, np.uint8)
    left, _ = rectifier.rectify(white, white)
    x, y, width, height = rectifier.valid_window
    assert 15 <= 64 - width <= 25
    outside = np.ones_like(rectifier.valid)
    outside[y : y + height, x : x + width] = False
    assert not rectifier.valid[outside].any()
    assert (left[rectifier.valid] == 255).all()
    assert left[~rectifier.valid].min() == 0


@pytest.mark.parametrize(("changes", "message"), [
    ({"distortion_model": "spline", "d": [0.1]}, "distortion model 'spline'"),
    ({"d": [0.1, 0.2]}, "2 coefficients in D"),
    ({"d": [math.nan] * 5}, "all finite"),
    ({"r": [0.5, 0, 0.866, 0, 1, 0, -0.866, 0, 0.5]}, "map all pixels out of the image"),
])
def test_distortion_that_cannot_be_undone_is_named(changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Rectifier(camera_info(**changes), right_info(**changes))


@pytest.mark.parametrize("number", [0, 5, 10])
def test_no_coefficients_or_zeros_mean_no_distortion(number: int) -> None:
    rectifier = Rectifier(camera_info(d=[0.0] * number), right_info(d=[0.0] * number))
    image = np.random.default_rng(1).integers(0, 256, (48, 64), np.uint8)
    np.testing.assert_array_equal(rectifier.rectify(image, image)[1], image)


def test_recorded_raw_pair_becomes_the_recorded_rectified_pair(shared_data: Path) -> None:
    rosbags = pytest.importorskip("rosbags.highlevel", reason="rosbags is not installed")
    folder = shared_data / "underwater"
    infos: dict[str, Any] = {}
    raws: dict[str, list[np.ndarray]] = {"left": [], "right": []}
    with rosbags.AnyReader([folder / "bermuda_raw_bag"]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            side = connection.topic.split("/")[2]
            if connection.topic.endswith("camera_info"):
                infos[side] = message
            else:
                raws[side].append(message.data.reshape(message.height, message.width, 3))
    calibration = json.loads((folder / "bermuda" / "calibration.json").read_text())
    rectifier = Rectifier(infos["left"], infos["right"])
    assert rectifier.rig == StereoRig.from_projection(calibration["P1"], calibration["P2"])
    pairs = [rectifier.rectify(*p) for p in zip(raws["left"], raws["right"], strict=True)]
    for side in (0, 1):
        name = ("left", "right")[side]
        errors = [
            min(np.abs(pair[side].astype(int) - cv2.imread(str(path))).mean() for pair in pairs)
            for path in sorted((folder / "bermuda").glob(f"{name}_*.png"))
        ]
        assert min(errors) < 1.0
