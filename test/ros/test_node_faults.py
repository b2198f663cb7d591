# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What goes wrong around a node, each fault survived, and the next good frame processed."""

from __future__ import annotations

import array
import inspect
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from stereo_msgs.msg import DisparityImage

NAMESPACE = "/tough"

# Publishes the known scene from a process of its own, until it is killed.
PUBLISHER = """
import importlib.util, pathlib, sys, time
sys.path.append(str(pathlib.Path(sys.argv[1]).parents[1]))
specification = importlib.util.spec_from_file_location("parts", sys.argv[1])
parts = sys.modules["parts"] = importlib.util.module_from_spec(specification)
specification.loader.exec_module(parts)
client = parts.Client(parts.input_topics(), sys.argv[2])
scene = parts.make_scene()
messages = [parts.image_message(p, "rgb8") for p in (scene.left, scene.right)]
messages += [parts.info_message(side) for side in ("left", "right")]
stamp = int(sys.argv[3])
while True:
    stamp += 1
    client.publish(*messages, stamp=stamp)
    time.sleep(0.1)
"""


@pytest.fixture(scope="module")
def node(start_node: Callable[..., Any]) -> Any:
    return start_node("-r", f"__ns:={NAMESPACE}", "-p", "stereo.max_disparity:=40")


@pytest.fixture(scope="module")
def client(node: Any, make_client: Callable[..., Any], parts: Any) -> Any:
    client = make_client(namespace=NAMESPACE)
    client.connect(*parts)
    return client


def good_frame(client: Any, parts: Any) -> None:
    client.result(client.publish(*parts), "disparity", "visibility/attenuation")


def test_size_that_changes_in_flight_is_followed(
    node: Any, client: Any, parts: Any, scene: Any, image: Any, info: Any
) -> None:
    rows = slice(8, 104)
    smaller = [image(np.ascontiguousarray(p[rows]), "rgb8") for p in (scene.left, scene.right)]
    infos = []
    for side in ("left", "right"):
        # A region of interest, as a driver states it.
        cropped = info(side)
        cropped.roi.y_offset, cropped.roi.width, cropped.roi.height = 8, 160, 96
        infos.append(cropped)
    before = int(client.diagnosed("pipeline", "").numbers["calibrations"])
    for _ in range(2):
        stamp = client.publish(*smaller, *infos)
        disparity = client.result(stamp, "disparity")[0]
        assert (disparity.image.width, disparity.image.height) == (160, 96)
        values = np.frombuffer(disparity.image.data, np.float32).reshape(96, 160)
        matched = values >= disparity.min_disparity
        assert np.median(np.abs(values - scene.disparity[rows])[matched]) < 0.5
    good_frame(client, parts)
    client.wait(
        lambda: int(client.diagnosis("pipeline").numbers["calibrations"]) == before + 2,
        "the count of calibrations",
    )
    assert "using the new calibration" in node.log


def test_a_calibration_of_images_of_another_size_is_told(
    node: Any, client: Any, parts: Any, info: Any
) -> None:
    infos = [info(side) for side in ("left", "right")]
    for each in infos:
        each.p = np.array(each.p) * [1, 1, 2, 1, 1, 1, 2, 1, 1, 1, 1, 1]
    client.result(client.publish(*parts[:2], *infos), "disparity")
    for side in ("left", "right"):
        node.wait_for(f"{side} camera_info has the principal point ")
    good_frame(client, parts)


def test_calibration_that_changes_all_the_time_does_not_fill_the_log(
    node: Any, client: Any, parts: Any, info: Any
) -> None:
    before = int(client.diagnosed("pipeline", "").numbers["calibrations"])
    said, began = node.log.count("using the new calibration"), time.monotonic()
    for number in range(1, 11):
        other = [info(side, d=[1e-6 * number] * 5) for side in ("left", "right")]
        client.result(client.publish(*parts[:2], *other), "disparity")
    client.wait(
        lambda: int(client.diagnosis("pipeline").numbers["calibrations"]) >= before + 10,
        "the count of calibrations",
    )
    # A reason is told again after 5 s at the earliest, however slowly frames are answered.
    again = (time.monotonic() - began) // 5.0
    assert node.log.count("using the new calibration") <= said + 2 + again
    good_frame(client, parts)


def test_image_beyond_the_limit_does_not_wait_in_memory(
    client: Any, parts: Any, image: Callable[..., Any], scene: Any
) -> None:
    def limit(megapixels: float) -> None:
        parameter = Parameter("max_megapixels", value=megapixels).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        assert client.call("uw_visibility/set_parameters", request).results[0].successful

    limit(0.02)
    large = image(scene.left, "rgb8", data=array.array("B", bytes(200_000)))
    large.header.stamp.sec = client.next_stamp()
    client.publishers["left/image"].publish(large)
    reason = "dropped: left image larger than max_megapixels"
    client.wait(lambda: client.diagnosis("input").numbers.get(reason) == "1", "the count of it")
    assert client.diagnosis("input").numbers["waiting images"] == "0"
    limit(8.0)
    good_frame(client, parts)


def test_burst_is_answered_with_its_newest_frame_and_memory_stays(
    node: Any, client: Any, parts: Any
) -> None:
    def burst() -> list[int]:
        stamps = [client.publish(*parts) for _ in range(200)]
        client.result(stamps[-1], "disparity")
        return stamps

    burst()
    before = node.memory
    stamps = burst()
    assert sum(client.has("disparity", stamp) for stamp in stamps) < len(stamps)
    assert node.memory - before < 20.0
    client.wait(
        lambda: int(client.diagnosis("pipeline").numbers["frames skipped"]) > 0, "skipped frames"
    )
    assert int(client.diagnosis("input").numbers["waiting images"]) <= 20
    good_frame(client, parts)


def test_subscriber_that_comes_and_goes(node: Any, client: Any, parts: Any) -> None:
    for index in range(50):
        subscription = client.node.create_subscription(
            DisparityImage, "disparity", lambda message: None, QoSProfile(depth=1)
        )
        if index % 5 == 0:
            client.publish(*parts)
        client.node.destroy_subscription(subscription)
    good_frame(client, parts)
    assert "Traceback" not in node.log


def test_publisher_that_is_killed_and_returns(
    start_node: Callable[..., Any], client: Any, parts: Any
) -> None:
    for _ in range(2):
        start = client.next_stamp() + 1000
        client._seconds = start + 1000
        arguments = [inspect.getfile(type(client)), NAMESPACE, str(start)]
        publisher = start_node(
            code=f"import sys; sys.argv[1:] = {arguments}\n{PUBLISHER}", ready=False).process
        client.wait(
            lambda s=start: any(s < m.header.stamp.sec < s + 900
                                for m in list(client.received["disparity"])),
            "an answer to the other publisher", timeout=40.0,
        )
        publisher.kill()
        publisher.wait()
    good_frame(client, parts)


def test_short_recording_is_answered_each_time_it_is_played(
    start_node: Callable[..., Any], make_client: Callable[..., Any], parts: Any
) -> None:
    start_node("-r", "__ns:=/again", "-p", "stereo.max_disparity:=40")
    client = make_client(namespace="/again")
    topics = {name: (p.msg_type, p.topic_name) for name, p in client.publishers.items()}
    frames, plays = 9, 3

    def adapted(reliability: str) -> None:
        """Wait until the node has noticed that publishers are there, or that they are gone."""
        names = [f"reliability of {side}/image_rect" for side in ("left", "right")]
        client.wait(
            lambda: [client.diagnosis("input").numbers.get(name) for name in names]
            == [reliability] * 2, f"{reliability} subscriptions",
        )

    for play in range(plays):
        if play:
            # As a player does that is started anew.
            for name, (kind, topic) in topics.items():
                client.publishers[name] = client.node.create_publisher(kind, topic, 50)
        adapted("reliable")
        client.wait(
            lambda: all(p.get_subscription_count() == 1 for p in client.publishers.values()),
            "a subscription to each input",
        )
        before = len(client.received["disparity"])
        for number in range(frames):
            client.publish(*parts, stamp=7, nanosec=100_000_000 * number)
            # One after the other, since a loaded machine skips what it has no time for. The
            # first may be lost while publisher and node find one another.
            answered = len(client.received["disparity"])
            end = time.monotonic() + (2.0 if number == 0 else 20.0)
            while len(client.received["disparity"]) == answered and time.monotonic() < end:
                time.sleep(0.01)
        assert len(client.received["disparity"]) - before >= frames - 1
        for publisher in client.publishers.values():
            client.node.destroy_publisher(publisher)
        adapted("best effort")

    def numbers(part: str) -> dict[str, str]:
        return client.diagnosed(part, "").numbers

    given, done = numbers("input"), numbers("pipeline")
    answered = len(client.received["disparity"])
    assert int(done["frames processed"]) == answered
    lost = plays * frames - answered
    assert lost == int(done["frames skipped"]) + int(given["dropped images"]) // 2


def test_clock_that_jumps_back_starts_anew(
    start_node: Callable[..., Any], make_client: Callable[..., Any], parts: Any
) -> None:
    node = start_node("-r", "__ns:=/simulated", "-p", "use_sim_time:=true")
    client = make_client(namespace="/simulated")
    clock = client.node.create_publisher(Clock, "/clock", QoSProfile(depth=10))

    def tick(seconds: int) -> None:
        message = Clock()
        message.clock.sec = seconds
        clock.publish(message)

    client.wait(lambda: clock.get_subscription_count() > 0, "a subscription to the clock")
    client.connect(*parts)
    for start in (1000, 500):
        for second in range(start, start + 3):
            tick(second)
            time.sleep(0.05)
            client.result(client.publish(*parts, stamp=second), "disparity")
    assert node.log.count("time jumped back") == 1
    client.wait(
        lambda: [a.header.stamp.sec for a in client.received["/diagnostics"][-1:]] == [502],
        "the clock's time",
    )
    assert abs(float(client.diagnosis("pipeline").numbers["latency (ms)"])) < 1500.0
    assert client.diagnosis("input").numbers["restarts"] == "1"
