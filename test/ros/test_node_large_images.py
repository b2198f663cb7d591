# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Images of a camera's size and rate, with the middleware as it comes: most of them arrive."""

from __future__ import annotations

import contextlib
import json
import pickle
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from rclpy.serialization import serialize_message

pytestmark = pytest.mark.alone

NAMESPACE = "/large"
# Each pair comes at once and has to find room where it arrives. The next one comes when it has,
# or is lost: how many come in a second would only test how busy the machine is.
FRAMES = 24
LOST = 3.0  # s
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
    client: Any, frame: Path, reliability: str, *options: str, **environment: str
) -> dict[str, int]:
    """Publish pair after pair; return what the node counts of them."""
    counted = ("stereo frames", "left received", "right received")

    def count() -> dict[str, int]:
        given = client.diagnosed("input", "").numbers
        assert not any("seen before" in name for name in given), given
        return {name: int(given[name]) - before.get(name, 0) for name in counted}

    before: dict[str, int] = {}
    before = count()
    camera = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.node_publisher", str(frame),
         "--frames", str(FRAMES), "--paced", "--wait", "0", *options],
        env=client.environment | environment, cwd=ROOT, stdin=subprocess.PIPE,
        stdout=subprocess.PIPE, text=True,
    )
    try:
        assert camera.stdin is not None and camera.stdout is not None
        assert camera.stdout.readline() == "ready\n", "the node does not hear the camera"
        for side in ("left", "right"):
            name = f"reliability of {side}/image_rect"
            client.wait(
                lambda n=name: client.diagnosis("input").numbers[n] == reliability, reliability)
        arrived = count()
        for _ in range(FRAMES):
            camera.stdin.write("\n")
            camera.stdin.flush()
            end, wanted = time.monotonic() + LOST, min(arrived.values()) + 1
            while min(arrived.values()) < wanted and time.monotonic() < end:
                time.sleep(0.01)
                arrived = count()
        assert json.loads(camera.stdout.readline())["sent"] == FRAMES
    finally:
        # A middleware that hangs at its end would keep this test, and others behind it.
        with contextlib.suppress(subprocess.TimeoutExpired):
            camera.communicate(timeout=20.0)
        camera.kill()
        camera.wait()
    return count()


def test_images_of_a_reliable_camera_arrive(client: Any, frame: Path) -> None:
    arrived = publish(client, frame, "reliable")
    assert min(arrived.values()) >= 0.8 * FRAMES, arrived
    assert max(arrived.values()) <= FRAMES, arrived


@pytest.mark.parametrize("profile", [None, ROOT / "config" / "fastdds.xml"])
def test_images_of_a_best_effort_camera_arrive(
    client: Any, frame: Path, profile: Path | None
) -> None:
    allowed = Path("/proc/sys/net/core/rmem_max")
    if not allowed.exists() or int(allowed.read_text()) < 2 * 640 * 480 * 3:
        pytest.skip("the system allows a socket no memory for a pair: net.core.rmem_max")
    environment = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profile)} if profile else {}
    arrived = publish(client, frame, "best effort", "--best-effort", **environment)
    assert min(arrived.values()) >= 0.8 * FRAMES, arrived
    assert max(arrived.values()) <= FRAMES, arrived
