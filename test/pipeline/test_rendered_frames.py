# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A rendered reef, of which all is known, through the messages: geometry and water come back."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from plain_messages import HEADER, camera_info, image_message, make, mosaic
from scenes import ReefView, processed

from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.messages.frames import StereoFrame
from uw_visibility.messages.processor import FrameProcessor
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.frame import RenderedFrame
from uw_visibility_lab.simulation.water import Water

CAMERA = StereoCamera()
TOPICS = ("disparity", "visibility/attenuation", "visibility/attenuation_stddev")
SETTINGS = PipelineConfig.from_parameters({"stereo.max_disparity": 96}), NodeConfig()


YUV = {"uyvy": "u0v1", "yuv422": "u0v1", "yuyv": "0u1v", "yuv422_yuy2": "0u1v"}


@pytest.fixture(scope="module")
def rendered() -> RenderedFrame:
    """Render a reef from 1.5 m above it, in water of 0.2 1/m at 3 m of depth."""
    return ReefView(CAMERA, water=Water(0.2, 3.0)).frame()


@pytest.fixture(scope="module")
def processor() -> FrameProcessor:
    return FrameProcessor(make, rectify=False)


def yuv422(pixels: np.ndarray, order: str) -> np.ndarray:
    """Lay RGB pixels out as ITU-R BT.601 has it, two of them with one colour."""
    matrix = np.array([
        [65.481, 128.553, 24.966], [-37.797, -74.203, 112.0], [112.0, -93.786, -18.214],
    ])
    y, u, v = np.moveaxis(pixels @ matrix.T / 255 + (16, 128, 128), -1, 0)
    u, v = (plane.reshape(plane.shape[0], -1, 2).mean(axis=2) for plane in (u, v))
    planes = {"u": u, "v": v, "0": y[:, ::2], "1": y[:, 1::2]}
    quad = np.stack([planes[name] for name in order], axis=-1)
    return np.round(quad).astype(np.uint8).reshape(*pixels.shape[:2], 2)


def image(pixels: np.ndarray, encoding: str) -> SimpleNamespace:
    """Make an Image of RGB pixels as an encoding lays them out; 16 bits big-endian."""
    name, bits = encoding.rstrip("0168"), 16 if encoding.endswith("16") else 8
    if bits == 16:
        pixels = (pixels.astype(np.uint16) * 257).astype(">u2")
    if name.startswith("bayer_"):
        stored = mosaic(pixels, name.removeprefix("bayer_"))
    else:
        alpha = np.full(pixels.shape[:2], 255, pixels.dtype)
        stored = yuv422(pixels, YUV[encoding]) if encoding in YUV else {
            "8UC": pixels[..., ::-1] if encoding == "8UC3" else pixels[..., 1],
            "mono": pixels[..., 1], "rgb": pixels, "bgr": pixels[..., ::-1],
            "rgba": np.dstack([pixels, alpha]), "bgra": np.dstack([pixels[..., ::-1], alpha]),
        }[encoding[:3] if encoding.startswith("8UC") else name]
    return image_message(stored, encoding, is_bigendian=int(bits == 16))


def compressed(pixels: np.ndarray, codec: str, quality: int = 95) -> SimpleNamespace:
    """Make a CompressedImage as compressed_image_transport does."""
    stored = np.ascontiguousarray(pixels[..., ::-1])
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if codec == ".jpg" else []
    data = cv2.imencode(codec, stored, options)[1].tobytes()
    kind = {".jpg": "jpeg", ".png": "png"}[codec]
    return SimpleNamespace(header=HEADER, format=f"rgb8; {kind} compressed bgr8", data=data)


def info(offset: float, cx: float) -> SimpleNamespace:
    """Make the CameraInfo of a camera so far to the right of the left one, m."""
    centre, size = (cx, CAMERA.principal_point[1]), (CAMERA.width, CAMERA.height)
    return camera_info(size, CAMERA.focal_length, centre, -CAMERA.focal_length * offset)


def process(processor: FrameProcessor, left: Any, right: Any, shift: int = 0) -> dict[str, Any]:
    cx = CAMERA.principal_point[0]
    infos = info(0.0, cx), info(CAMERA.baseline, cx - shift)
    return processed(processor, StereoFrame(left, right, *infos), *SETTINGS, TOPICS)[1]


def disparities(message: Any) -> np.ndarray:
    """Return what a DisparityImage says; NaN where it says that it does not know."""
    values = np.frombuffer(message.image.data, np.float32).reshape(CAMERA.height, CAMERA.width)
    return np.where(values >= message.min_disparity, values, np.nan)


def vector(messages: dict[str, Any], topic: str) -> np.ndarray:
    found = messages[topic].vector
    return np.array([found.x, found.y, found.z])


def attenuation(messages: dict[str, Any]) -> np.ndarray:
    return vector(messages, "visibility/attenuation")


@pytest.mark.parametrize("shift", [0, 7])
def test_distance_from_the_disparity_message_alone_is_that_of_the_renderer(
    processor: FrameProcessor, rendered: RenderedFrame, shift: int
) -> None:
    # A right camera whose principal point lies further left sees all further left.
    right = np.roll(rendered.right, -shift, axis=1)
    messages = process(processor, image(rendered.left, "rgb8"), image(right, "rgb8"), shift)
    message = messages["disparity"]
    found = message.f * message.t / disparities(message)
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width]
    cx, cy = CAMERA.principal_point
    rays = np.sqrt(1 + ((x - cx) ** 2 + (y - cy) ** 2) / CAMERA.focal_length**2)
    truth = rendered.range_left / rays
    # As far as contrast of the scene is left, down to a fiftieth.
    known = np.isfinite(found) & (rendered.range_left < 17.0)
    assert known.mean() > 0.5
    errors = np.abs(found - truth)[known] / truth[known]
    assert np.median(errors) <= 0.01
    # With the offset on the wrong side, most would be far off.
    assert np.mean(errors > 0.1) < 0.05


@pytest.fixture(scope="module")
def pair(rendered: RenderedFrame) -> list[np.ndarray]:
    """Return the images behind a lens: a mosaic cannot hold what changes from pixel to pixel."""
    return [cv2.GaussianBlur(p, (0, 0), 1.5) for p in (rendered.left, rendered.right)]


@pytest.fixture(scope="module")
def expected(
    processor: FrameProcessor, rendered: RenderedFrame, pair: list[np.ndarray]
) -> np.ndarray:
    """Return β of the reef as rgb8, which is near the truth."""
    found = attenuation(process(processor, *(image(p, "rgb8") for p in pair)))
    np.testing.assert_allclose(found, rendered.attenuation, rtol=0.1)
    return found


# Each is read by itself in test/messages/test_images.py.
@pytest.mark.parametrize(
    "encoding", ["8UC1", "bayer_gbrg16", "bgr16", "bgra8", "mono16", "yuv422_yuy2", ".jpg", ".png"])
def test_every_encoding_tells_the_same(
    processor: FrameProcessor, rendered: RenderedFrame, pair: list[np.ndarray],
    expected: np.ndarray, encoding: str,
) -> None:
    make_image = compressed if encoding.startswith(".") else image
    messages = process(processor, *(make_image(p, encoding) for p in pair))
    errors = np.abs(disparities(messages["disparity"]) - rendered.disparity_left)
    matched = np.isfinite(errors)
    assert matched.mean() > 0.5
    assert np.median(errors[matched]) < 0.5
    if "mono" in encoding or encoding == "8UC1":
        assert "visibility/attenuation" not in messages
        return
    # JPEG drops weak contrasts, of which far water consists: less of it is matched.
    # YUV stores colour at half of the resolution and has no room for it in dark red.
    tolerance = 0.14 if encoding in YUV else 0.08 if encoding == ".jpg" else 0.05
    np.testing.assert_allclose(attenuation(messages), expected, rtol=tolerance)


# Without regard to what a JPEG rounds, red comes out lower by 27 to 31 %.
@pytest.mark.parametrize(("make_image", "red"), [
    (lambda pixels: compressed(pixels, ".jpg", 95), 0.05),
    (lambda pixels: compressed(pixels, ".jpg", 80), 0.07),
    (lambda pixels: image(pixels, "bayer_rggb8"), 0.06),
])
def test_noisy_pixels_tell_the_same_through_a_codec_and_a_mosaic(
    processor: FrameProcessor, rendered: RenderedFrame, make_image: Callable[..., Any],
    red: float,
) -> None:
    sides = rendered.left, rendered.right
    expected = attenuation(process(processor, *(image(p, "rgb8") for p in sides)))
    messages = process(processor, *(make_image(p) for p in sides))
    found, stddev = attenuation(messages), vector(messages, "visibility/attenuation_stddev")
    assert abs(found[0] / expected[0] - 1) < red
    assert (np.abs(found - expected) < 1.5 * stddev).all()
    assert (stddev < 0.2 * found).all()
