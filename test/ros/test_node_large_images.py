# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Images of a camera's size and rate, with the middleware as it comes: most of them arrive."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from rclpy.serialization import serialize_message

pytestmark = pytest.mark.alone

NAMESPACE = "/large"
# Each pair comes at once and has to find room where it arrives; how many come in a second
# would only test how busy the machine is.
FRAMES = 24
RATE = 4
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def client(start_node: Callable[..., Any], make_client: Callable[..., Any]) -> Any:
    start_node("-r", f"__ns:={NAMESPACE}")
    # The camera is a process of its own; this one looks at the diagnostics.
    return make_client({"left/image": "other"}, namespace=NAMESPACE)


@pytest.fixture(scope="module")
def frame(tmp_path_factory: pytest.TempPathFactory, image: Any, info: Any) -> Path:
    """Write a frame that costs no time: its CameraInfo is of another size."""
    pixels = np.zeros((480, 640, 3), np.uint8)
    messages = {
        f"{NAMESPACE}/{side}/{topic}": message
        for side in ("left", "right")
        for topic, message in (("image_rect", image(pixels, "rgb8")), ("camera_info", info(side)))
    }
    types = {
        topic: f"sensor_msgs/msg/{type(message).__name__}" for topic, message in messages.items()
    }
    file = tmp_path_factory.mktemp("camera") / "frame.pickle"
    serialised = {topic: serialize_message(message) for topic, message in messages.items()}
    file.write_bytes(pickle.dumps((types, serialised)))
    return file


def publish(
    client: Any, frame: Path, *options: str, **environment: str
) -> tuple[dict[str, int], str]:
    """Publish; return what the node counts of it, and the reliability meanwhile."""
    camera = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.node_publisher", str(frame),
         "--frames", str(FRAMES), "--rate", str(RATE), *options],
        env=client.environment | environment, cwd=ROOT, stdout=subprocess.PIPE,
    )
    counted = ("stereo frames", "left received", "right received")

    def count() -> dict[str, int]:
        given = client.diagnosed("input", "").numbers
        assert not any("seen before" in name for name in given), given
        return {name: int(given[name]) for name in counted}

    before = count()
    client.wait(lambda: count()["left received"] > before["left received"], "an image")
    reliability = client.diagnosis("input").numbers["reliability of left/image_rect"]
    assert json.loads(camera.communicate()[0])["sent"] == FRAMES
    arrays = len(client.received["/diagnostics"])
    client.wait(lambda: len(client.received["/diagnostics"]) > arrays + 1, "the last count")
    return {name: after - before[name] for name, after in count().items()}, reliability


def test_images_of_a_reliable_camera_arrive(client: Any, frame: Path) -> None:
    arrived, reliability = publish(client, frame)
    assert min(arrived.values()) >= 0.8 * FRAMES, arrived
    assert max(arrived.values()) <= FRAMES, arrived
    assert reliability == "reliable"


@pytest.mark.parametrize("profile", [None, ROOT / "config" / "fastdds.xml"])
def test_images_of_a_best_effort_camera_arrive(
    client: Any, frame: Path, profile: Path | None
) -> None:
    allowed = Path("/proc/sys/net/core/rmem_max")
    if not allowed.exists() or int(allowed.read_text()) < 2 * 640 * 480 * 3:
        pytest.skip("the system allows a socket no memory for a pair: net.core.rmem_max")
    environment = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profile)} if profile else {}
    arrived, reliability = publish(client, frame, "--best-effort", **environment)
    assert min(arrived.values()) >= 0.8 * FRAMES, arrived
    assert max(arrived.values()) <= FRAMES, arrived
    assert reliability == "best effort"
