# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames of messages become pairs; what does not belong together is named."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from plain_messages import camera_info
from plain_messages import image_message as image

from uw_visibility.errors import InputError
from uw_visibility.messages.frames import FrameReader, StereoFrame

FOCAL = 50.0


def info(tx: float, **changes: Any) -> SimpleNamespace:
    return camera_info((32, 24), FOCAL, (15.5, 11.5), tx, **changes)


GREY = np.random.default_rng(2).integers(0, 256, (24, 32), np.uint8)


def frame(**changes: Any) -> StereoFrame:
    parts = {
        "left": image(GREY), "right": image(GREY[:, ::-1].copy()),
        "left_info": info(0.0), "right_info": info(-5.0),
    }
    return StereoFrame(**(parts | changes))


def test_rectified_frame_is_passed_on() -> None:
    pair = FrameReader(rectify=False).read(frame())
    np.testing.assert_array_equal(pair.left, GREY)
    np.testing.assert_array_equal(pair.right, GREY[:, ::-1])
    assert (pair.rig.baseline, pair.valid, pair.valid_window) == (0.1, None, (0, 0, 32, 24))


def compressed(pixels: np.ndarray, codec: str = ".png") -> SimpleNamespace:
    return SimpleNamespace(format="jpeg", data=cv2.imencode(codec, pixels)[1].tobytes())


def test_compressed_frame_is_read() -> None:
    colour = np.dstack([GREY, GREY // 2, GREY // 3])
    pair = FrameReader(rectify=False).read(
        frame(left=compressed(colour), right=compressed(colour))
    )
    np.testing.assert_array_equal(pair.left, colour[..., ::-1])
    assert pair.encodings == ("bgr8", "bgr8")


def test_compressed_and_raw_images_make_a_pair() -> None:
    pair = FrameReader(rectify=False).read(frame(left=compressed(GREY)))
    np.testing.assert_array_equal(pair.left, GREY)
    assert pair.encodings == ("mono8", "mono8")


def test_raw_frame_is_rectified() -> None:
    # Half a turn about the principal point, which is the image's centre.
    turned = {"r": [-1, 0, 0, 0, -1, 0, 0, 0, 1]}
    pair = FrameReader(rectify=True).read(
        frame(left_info=info(0.0, **turned), right_info=info(-5.0, **turned))
    )
    np.testing.assert_array_equal(pair.left, GREY[::-1, ::-1])
    np.testing.assert_array_equal(pair.right, GREY[::-1])
    assert pair.valid is not None and pair.valid.all()
    assert pair.valid_window == (0, 0, 32, 24)


def test_colour_of_a_jpeg_is_read_and_rectified_with_its_image() -> None:
    y, x = np.mgrid[:24, :32].astype(np.uint8)
    colour = np.dstack([40 + 4 * x, 200 - 5 * y, 60 + 2 * x])
    image = compressed(colour, ".jpg")
    turned = {"r": [-1, 0, 0, 0, -1, 0, 0, 0, 1]}
    raw = FrameReader(rectify=False).read(frame(left=image, right=image)).chroma
    pair = FrameReader(rectify=True).read(frame(
        left=image, right=image, left_info=info(0.0, **turned), right_info=info(-5.0, **turned)
    ))
    assert raw is not None and raw.pixels is not None
    assert pair.chroma is not None and pair.chroma.pixels is not None
    np.testing.assert_array_equal(pair.chroma.pixels, raw.pixels[::-1, ::-1])
    assert pair.chroma.scale == raw.scale == 2
    means = pair.left.reshape(12, 2, 16, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(pair.chroma.pixels / 257, means, atol=4)


def test_raw_images_have_no_more_than_their_pixels() -> None:
    assert FrameReader(rectify=False).read(frame()).chroma is None


def test_calibration_is_read_again_only_when_it_changes() -> None:
    reader = FrameReader(rectify=False)
    first = reader.read(frame())
    assert reader.read(frame(left_info=info(0.0))).rig is first.rig
    assert reader.calibrations == 1
    assert reader.read(frame(right_info=info(-6.0))).rig.baseline == 0.12
    assert reader.calibrations == 2


def test_bad_calibration_does_not_outlive_its_frame() -> None:
    reader = FrameReader(rectify=True)
    reader.read(frame())
    with pytest.raises(InputError, match="not calibrated"):
        reader.read(frame(left_info=info(0.0, k=[0.0] * 9)))
    assert reader.read(frame()).rig.baseline == 0.1


@pytest.mark.parametrize(("changes", "message"), [
    ({"left": image(GREY[:12])}, "left image has 32x12 pixels and its camera_info 32x24"),
    ({"right_info": info(-5.0, width=16)}, "right image has 32x24 pixels and its camera_info 16"),
    (
        {"right": image(GREY[:12]), "right_info": info(-5.0, height=12)},
        "differ in size, 32x24 and 32x12 pixels: both cameras must send images of one size",
    ),
    ({"left": image(GREY, "nv21")}, "left image has the encoding 'nv21'"),
    ({"left_info": info(-5.0), "right_info": info(0.0)}, "swapped"),
])
def test_messages_that_do_not_belong_together_are_named(
    changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        FrameReader(rectify=False).read(frame(**changes))
