# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The node over compressed images with its optional outputs."""

from __future__ import annotations

import array
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CompressedImage


def compressed(
    pixels: np.ndarray, kind: str = "rgb8; png compressed bgr8", codec: str = ".png"
) -> CompressedImage:
    """Compress RGB or grey pixels as compressed_image_transport does."""
    stored = pixels if pixels.ndim == 2 else pixels[..., ::-1]
    data = cv2.imencode(codec, np.ascontiguousarray(stored))[1].tobytes()
    return CompressedImage(format=kind, data=array.array("B", data))


@pytest.fixture(scope="module")
def node(start_node: Callable[..., Any]) -> Any:
    return start_node(
        "-r", "__ns:=/compressed", "-p", "image_transport:=compressed",
        "-p", "publish_depth_image:=true", "-p", "publish_points:=true",
        "-p", "stereo.max_disparity:=40", "-p", "plausibility.sensor_type:=none",
        "-r", "left/image_rect:=/cam/left/image", "-r", "right/image_rect:=/cam/right/image",
    )


@pytest.fixture(scope="module")
def client(node: Any, make_client: Callable[..., Any], scene: Any, info: Any) -> Any:
    client = make_client({
        # As image_transport has it, the image's topic is what is remapped.
        "left/image": "/cam/left/image/compressed", "right/image": "/cam/right/image/compressed",
        "left/camera_info": "left/camera_info", "right/camera_info": "right/camera_info",
    }, namespace="/compressed")
    images = map(compressed, (scene.left, scene.right))
    client.connect(*images, info("left"), info("right"))
    return client


def coloured(pixels: np.ndarray) -> np.ndarray:
    return pixels


def grey(pixels: np.ndarray) -> np.ndarray:
    return pixels[..., 1]


@pytest.fixture(scope="module")
def attenuation(client: Any, large_scene: Any, info: Any) -> np.ndarray:
    """Return what the node finds of the scene without loss."""
    images = map(compressed, (large_scene.left, large_scene.right))
    stamp = client.publish(*images, info("left", scale=2), info("right", scale=2))
    vector = client.result(stamp, "visibility/raw/attenuation")[0].vector
    return np.array([vector.x, vector.y, vector.z])


# A JPEG has lost some of what the estimate needs, and is matched as noise is: attenuation moves by
# a standard deviation, which is 0.4 to 0.5 of that of green and blue.
@pytest.mark.parametrize(("kind", "codec", "layout", "encoding", "tolerance"), [
    ("bgr8; png compressed bgr8", ".png", coloured, "bgr8", 1e-6),
    ("jpeg", ".jpg", coloured, "bgr8", 0.5),
    ("mono8; jpeg compressed ", ".jpg", grey, "mono8", None),
])
def test_compressed_scene_gives_the_same_disparity_and_attenuation(
    client: Any, large_scene: Any, info: Any, attenuation: np.ndarray, kind: str, codec: str,
    layout: Callable[..., Any], encoding: str, tolerance: float | None,
) -> None:
    images = [compressed(layout(p), kind, codec) for p in (large_scene.left, large_scene.right)]
    stamp = client.publish(*images, info("left", scale=2), info("right", scale=2))
    disparity, enhanced = client.result(stamp, "disparity", "left/enhanced/image")
    assert (enhanced.encoding, enhanced.header.frame_id) == (encoding, "left_camera")
    values = np.frombuffer(disparity.image.data, np.float32).reshape(240, 320)
    matched = values >= disparity.min_disparity
    assert matched.mean() > 0.5
    assert np.median(np.abs(values - large_scene.disparity)[matched]) < 0.5
    if tolerance is not None:
        vector = client.result(stamp, "visibility/raw/attenuation")[0].vector
        np.testing.assert_allclose([vector.x, vector.y, vector.z], attenuation, rtol=tolerance)


def test_depth_image_and_points_agree_with_the_disparity(
    client: Any, scene: Any, info: Any
) -> None:
    images = map(compressed, (scene.left, scene.right))
    stamp = client.publish(*images, info("left"), info("right"))
    disparity, depth, calibration, points = client.result(
        stamp, "disparity", "depth/image", "depth/camera_info", "points2"
    )
    values = np.frombuffer(disparity.image.data, np.float32).reshape(120, 160)
    matched = values >= disparity.min_disparity
    z = np.frombuffer(depth.data, np.float32).reshape(120, 160)
    np.testing.assert_array_equal(np.isfinite(z), matched)
    np.testing.assert_allclose(z[matched], disparity.f * disparity.t / values[matched], rtol=1e-6)
    error = np.abs(z - 20.0 / scene.disparity)[matched] * scene.disparity[matched] / 20.0
    assert np.median(error) < 0.01
    assert calibration.header == depth.header
    cloud = np.frombuffer(points.data, np.float32).reshape(120, 160, 4)
    np.testing.assert_array_equal(cloud[..., 2], z)
    rows, columns = np.nonzero(matched)
    projected = 200.0 * cloud[rows, columns, 0] / z[matched] + calibration.p[2]
    np.testing.assert_allclose(projected, columns, atol=1e-3)


def test_without_a_sensor_plausibility_is_switched_off(client: Any) -> None:
    status = client.diagnosed("plausibility", "switched off")
    assert status.level == DiagnosticStatus.OK


def test_lazy_node_rests_until_somebody_wants_a_result(
    start_node: Callable[..., Any], make_client: Callable[..., Any], parts: Any
) -> None:
    node = start_node("-r", "__ns:=/lazy", "-p", "lazy:=true", "-p", "stereo.max_disparity:=40")
    client = make_client(namespace="/lazy")
    # It hears this client, which wants everything.
    client.connect(*parts)
    begun = len(node.log)
    for topic in [topic for topic in client.received if topic != "/diagnostics"]:
        client.forget(topic)

    def heard() -> int:
        return sum(p.get_subscription_count() for p in client.publishers.values())

    client.wait(lambda: heard() == 0, "a rest")
    for part in ("input", "pipeline", "plausibility"):
        assert client.diagnosed(part, "at rest (lazy)").level == DiagnosticStatus.OK
    client.listen("visibility/attenuation")
    client.wait(lambda: heard() == 4, "an end of the rest")
    client.wait(
        lambda: client.publish(*parts) and time.sleep(0.2) is None
        and len(client.received["visibility/attenuation"]) > 0, "an answer",
    )
    assert "no output" not in node.log[begun:]
