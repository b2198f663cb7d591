# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Why there is no output, what was lost, and how the depth sensor does: said on /diagnostics."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from rcl_interfaces.srv import GetParameters
from rclpy.qos import QoSProfile

NAMESPACE = "/watched"


@pytest.fixture(scope="module")
def node(start_node: Callable[..., Any]) -> Any:
    return start_node("-r", f"__ns:={NAMESPACE}", "-p", "stereo.max_disparity:=40")


@pytest.fixture(scope="module")
def client(node: Any, make_client: Callable[..., Any], parts: Any) -> Any:
    """Go through a bad start, which the first test looks at, and end with a working node."""
    client = make_client(namespace=NAMESPACE)
    client.story = [client.diagnosed("input", "no left/image_rect yet")]
    end = time.monotonic() + 40.0
    # Until the next pair comes, a pair waits for it.
    while (
        "no right/camera_info yet" not in (status := client.diagnosis("input")).message
        or status.numbers["dropped images"] == "0"
    ):
        assert time.monotonic() < end, status
        stamp = client.next_stamp()
        inputs = ("left/image", "right/image", "left/camera_info")
        for name, message in zip(inputs, parts[:3], strict=True):
            message.header.stamp.sec = stamp
            client.publishers[name].publish(message)
        time.sleep(0.2)
    client.story.append(status)
    node.wait_for("no output: ")
    client.connect(*parts)
    return client


def test_missing_input_is_named_until_it_comes(node: Any, client: Any) -> None:
    nothing, half = client.story
    assert nothing.level == half.level == DiagnosticStatus.WARN
    # The client's publishers may be known already.
    assert "/watched/left/image_rect has " in nothing.message
    assert "/watched/right/camera_info has 1 publisher" in half.message
    assert int(half.numbers["left received"]) >= 1
    assert "no output: no " in node.log
    status = client.diagnosed("pipeline", "frames per second")
    assert status.level == DiagnosticStatus.OK
    dropped = client.diagnosis("input").numbers
    reasons = [key for key in dropped if key.startswith("dropped: ")]
    assert any("there is no" in reason and "camera_info" in reason for reason in reasons)


def test_numbers_of_a_working_node(client: Any, parts: Any) -> None:
    client.result(client.publish(*parts), "disparity")
    before = int(client.diagnosis("pipeline").numbers["frames processed"])
    for _ in range(12):
        client.result(client.publish(*parts), "disparity")
        time.sleep(0.1)
    client.wait(
        lambda: int(client.diagnosis("pipeline").numbers["frames processed"]) >= before + 12,
        "12 frames in the diagnostics",
    )
    pipeline = client.diagnosis("pipeline")
    assert pipeline.level == DiagnosticStatus.OK
    assert pipeline.numbers["status"] == "ok"
    for share in ("coverage", "matched fraction"):
        assert 0.5 < float(pipeline.numbers[share]) <= 1.0
    stages = (
        "support points (ms)", "improved disparity (ms)", "total (ms)",
        "around the pipeline (ms)", "latency (ms)",
    )
    assert all(float(pipeline.numbers[stage]) > 0 for stage in stages)
    client.wait(
        lambda: float(client.diagnosis("input").numbers["left rate (Hz)"]) > 0.0, "a rate"
    )
    given = client.diagnosis("input").numbers
    assert given["left received"] == given["right received"]
    assert (given["stamp gap (s)"], given["waiting images"]) == ("0.000000", "0")


def test_images_without_common_stamps_are_explained(node: Any, client: Any, parts: Any) -> None:
    unmatched = int(client.diagnosis("input").numbers["unmatched images"])
    end = time.monotonic() + 40.0
    message = "left and right images have no stamps in common: set synchronization.tolerance"
    while (
        message not in (status := client.diagnosis("input")).message
        or not status.numbers["smallest stamp gap since (s)"]
    ):
        assert time.monotonic() < end, status
        stamp = client.next_stamp()
        for side, part, nanoseconds in (("left", parts[0], 0), ("right", parts[1], 12_000_000)):
            part.header.stamp.sec, part.header.stamp.nanosec = stamp, nanoseconds
            client.publishers[f"{side}/image"].publish(part)
        time.sleep(0.2)
    assert status.level == DiagnosticStatus.ERROR
    assert status.numbers["smallest stamp gap since (s)"] == "-0.012000"
    assert status.numbers["stamp gap (s)"] == "0.000000"
    node.wait_for(f"no output: {message}")
    # What waited leaves with the next pair, counted.
    client.result(client.publish(*parts), "disparity")
    client.wait(
        lambda: int(client.diagnosis("input").numbers["unmatched images"]) > unmatched + 2,
        "the count of unmatched images",
    )


def test_images_without_stamps_are_explained(client: Any, parts: Any) -> None:
    end, pairs = time.monotonic() + 20.0, 0
    while "images have no stamp: fill header.stamp" not in client.diagnosis("input").message:
        assert time.monotonic() < end, client.diagnosis("input")
        pairs += 1
        for side, part in (("left", parts[0]), ("right", parts[1])):
            part.header.stamp.sec = part.header.stamp.nanosec = 0
            client.publishers[f"{side}/image"].publish(part)
        time.sleep(0.2)
    # A node that has no time for them forgets all but the last few.
    dropped = client.diagnosis("input").numbers["dropped: left image without a stamp"]
    assert 0 < int(dropped) <= pairs
    client.result(client.publish(*parts), "disparity")


def test_input_that_stops_is_noticed(node: Any, client: Any, parts: Any) -> None:
    client.result(client.publish(*parts), "disparity")
    status = client.diagnosed("input", "no left/image_rect any more")
    assert status.level == DiagnosticStatus.ERROR
    assert "no output: no left/image_rect any more" in client.diagnosis("pipeline").message
    node.wait_for("no output: no left/image_rect any more")
    client.result(client.publish(*parts), "disparity")
    client.diagnosed("pipeline", "frames per second")


def test_parameters_are_answered_while_a_frame_is_processed(
    client: Any, large_scene: Any, image: Any, info: Any
) -> None:
    # Frames that block the executor let one request pass at most, before they are taken.
    service = client.node.create_client(GetParameters, "uw_visibility/get_parameters")
    assert service.wait_for_service(timeout_sec=20.0)
    request = GetParameters.Request(names=["max_range"])
    parts = (
        image(large_scene.left, "rgb8"), image(large_scene.right, "rgb8"),
        info("left", scale=2), info("right", scale=2),
    )
    client.result(client.publish(*parts), "disparity")
    wanted, answers = 6, 0
    end = time.monotonic() + 40.0
    while answers < wanted:
        assert time.monotonic() < end, f"{answers} of {wanted} answers"
        stamp, answered = client.publish(*parts), 0
        while not client.has("disparity", stamp):
            future = service.call_async(request)
            while not (future.done() or client.has("disparity", stamp)):
                assert time.monotonic() < end, f"no answer to {stamp}, or to the request"
                time.sleep(0.001)
            answered += not client.has("disparity", stamp)
        answers += max(answered - 1, 0)
    client.node.destroy_client(service)


class Sensor:
    """Publishes depths as a pose, with each frame."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._publisher = client.node.create_publisher(
            PoseWithCovarianceStamped, "depth_sensor", QoSProfile(depth=50)
        )
        # Until the node knows the publisher too, it hears nothing of it.
        end = time.monotonic() + 40.0
        client.received["/diagnostics"].clear()
        while not (said := client.diagnosis("plausibility").message) or re.search(
            "no (sensor:|depth_sensor (yet|for))", said
        ):
            assert time.monotonic() < end, said
            self.publish(client.next_stamp(), 1.0)
            time.sleep(0.1)

    def publish(self, stamp: int, depth: float) -> None:
        message = PoseWithCovarianceStamped()
        message.header.stamp.sec, message.header.stamp.nanosec = stamp, 5
        message.pose.pose.position.z = -depth
        message.pose.covariance[14] = 0.01
        self._publisher.publish(message)

    def close(self) -> None:
        self._client.node.destroy_publisher(self._publisher)


def test_depth_sensor_is_checked(client: Any, parts: Any) -> None:
    status = client.diagnosed("plausibility", "no sensor: nobody publishes /watched/depth_sensor")
    assert status.level == DiagnosticStatus.OK
    # The known scene says little of its depth, so the gate may be wide.
    sensor = Sensor(client)
    assert client.set_parameters(
        plausibility__max_gate=100.0, plausibility__timeout=60.0).successful
    nis = client.received["depth_plausibility/nis"]
    stamped_nis = client.received["depth_plausibility/nis_stamped"]

    def frame(difference: float) -> float:
        """Let the sensor differ by so much, m; return the NIS."""
        count, stamp = len(stamped_nis), client.publish(*parts)
        depth = -client.result(stamp, "visibility/raw/depth")[0].pose.pose.position.z
        sensor.publish(stamp, depth + difference)
        client.wait(lambda: len(stamped_nis) == len(nis) == count + 1, "a NIS")
        return float(nis[-1].data)

    for _ in range(6):
        assert frame(0.0) < 1.0
    # The sensor's own and the model's are in it.
    assert stamped_nis[-1].vector.z > 0.01 + 0.25**2
    status = client.diagnosed("plausibility", "ok: sensor ", comparisons=6)
    assert status.level == DiagnosticStatus.OK
    stamped = stamped_nis[-1]
    assert stamped.vector.x == nis[-1].data
    assert stamped.vector.y**2 / stamped.vector.z == pytest.approx(stamped.vector.x)
    disparity = client.result(client._seconds, "disparity")[0]
    assert stamped.header.stamp == disparity.header.stamp
    assert stamped.header.frame_id == "map"
    variance = float(status.numbers["innovation variance (m^2)"])
    assert float(status.numbers["gate (m)"]) == pytest.approx(1.96 * math.sqrt(variance), rel=1e-2)
    for _ in range(5):
        assert frame(-60.0) > 10.0
    status = client.diagnosed("plausibility", "error: sensor -", beyond_the_gate=5)
    assert status.level == DiagnosticStatus.ERROR
    sensor.publish(client.next_stamp(), math.nan)
    status = client.diagnosed("plausibility", "depth_sensor says nan")
    assert status.numbers["refused sensor messages"] == "1"
    sensor.close()
    assert client.set_parameters(plausibility__timeout=1.0).successful
    status = client.diagnosed("plausibility", "stale: no ")
    assert status.level == DiagnosticStatus.STALE
