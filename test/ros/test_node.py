# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The real node in its own process: every topic and field, faults, and its end."""

from __future__ import annotations

import itertools
import math
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.images import read_image
from uw_visibility.messages.outputs import all_topics
from uw_visibility.status import Status

STAMPED = [
    topic for topic, name in all_topics(NodeConfig()).items() if name != "std_msgs/msg/Float64"]
# What an operator waits for, with a margin for a machine under load, s.
LONGEST_END = 10.0
IMAGES = [topic for topic in STAMPED if not topic.startswith("visibility/")]


@pytest.fixture(scope="module")
def node(start_node: Callable[..., Any]) -> Any:
    return start_node(
        "-p", "stereo.max_disparity:=40", "-p", "depth_frame:=odom", fresh=True)


@pytest.fixture(scope="module")
def client(node: Any, make_client: Callable[..., Any], parts: Any) -> Any:
    client = make_client()
    client.connect(*parts)
    return client


def depths(message: Any) -> np.ndarray:
    """Compute Z from a DisparityImage alone; NaN where it says invalid."""
    image = message.image
    disparity = np.frombuffer(image.data, np.float32).reshape(image.height, image.width)
    assert np.isfinite(disparity).all()
    valid = disparity >= message.min_disparity
    assert (disparity[valid] <= message.max_disparity).all()
    return np.where(valid, message.f * message.t / np.where(valid, disparity, 1), np.nan)


@pytest.mark.parametrize("offset", [0.0, 6.0])
def test_every_topic_of_a_known_scene(
    client: Any, scene: Any, image: Any, info: Any, offset: float
) -> None:
    # Moving the right image's content moves its principal point with it.
    right = np.roll(scene.right, -round(offset), axis=1)
    stamp = client.publish(
        image(scene.left, "rgb8"), image(right, "rgb8"), info("left"), info("right", offset)
    )
    messages = dict(zip(STAMPED, client.result(stamp, *STAMPED), strict=True))
    for topic, message in messages.items():
        side = topic.split("/")[0] if "enhanced" in topic else "left"
        frame = "odom" if topic.endswith("/depth") else f"{side}_camera"
        assert (message.header.stamp.nanosec, message.header.frame_id) == (5, frame), topic

    disparity = messages["disparity"]
    assert disparity.image.header == disparity.header
    assert (disparity.f, disparity.t) == (200.0, pytest.approx(0.1))
    assert disparity.delta_d > 0
    depth, truth = depths(disparity), 20.0 / scene.disparity
    matched = np.isfinite(depth)
    window = disparity.valid_window
    assert (window.x_offset, window.y_offset) == (0, 0)
    assert (window.width, window.height) == (160, 120)
    assert matched.mean() > 0.6
    assert np.median(np.abs(depth - truth)[matched] / truth[matched]) < 0.01

    for side, given in (("left", scene.left), ("right", right)):
        enhanced = messages[f"{side}/enhanced/image"]
        assert (enhanced.encoding, enhanced.width, enhanced.height) == ("rgb8", 160, 120)
        # The water took contrast.
        assert read_image(enhanced).std() > 1.2 * given.std()
    np.testing.assert_array_equal(messages["right/enhanced/camera_info"].p, info("right", offset).p)

    vectors = {
        name: np.array([getattr(messages[f"visibility/{name}"].vector, c) for c in "xyz"])
        for name in ("attenuation", "attenuation_stddev", "ambient_light")
    }
    off = np.abs(np.log(vectors["attenuation"] / scene.attenuation))
    assert (off < 2.0 * vectors["attenuation_stddev"] / vectors["attenuation"]).all()
    assert (vectors["attenuation_stddev"] < 0.5 * vectors["attenuation"]).all()
    np.testing.assert_allclose(vectors["ambient_light"], scene.ambient_light, rtol=0.2)
    distance = messages["visibility/distance"]
    assert distance.range == pytest.approx(2.351 / vectors["attenuation"].min(), rel=0.05)
    assert distance.variance > 0
    position = messages["visibility/depth"].pose.pose.position
    assert position.z <= 0 and math.isfinite(position.z)
    assert messages["visibility/depth"].pose.covariance[14] > 0


def test_node_sends_through_memory_for_a_whole_frame(node: Any, client: Any) -> None:
    maps = Path(f"/proc/{node.process.pid}/maps").read_text().splitlines()
    limits = [line.split()[0].split("-") for line in maps if "/fastrtps_" in line]
    assert max(int(stop, 16) - int(start, 16) for start, stop in limits) > 640 * 480 * (3 + 3 + 4)


def test_mean_attenuation_comes_with_every_frame(client: Any, parts: Any) -> None:
    before = len(client.received["visibility/mean_attenuation"])
    client.publish(*parts)
    client.wait(
        lambda: len(client.received["visibility/mean_attenuation"]) > before, "a mean attenuation"
    )
    value = client.received["visibility/mean_attenuation"][-1].data
    assert 0.0 < value < 0.6


# Each encoding is read in test/messages/test_images.py and test/pipeline/test_rendered_frames.py.
def test_grey_scene_is_matched_and_says_nothing_of_the_water(
    client: Any, scene: Any, image: Any, info: Any, parts: Any
) -> None:
    images = [image(p[..., 1], "mono8") for p in (scene.left, scene.right)]
    stamp = client.publish(*images, info("left"), info("right"))
    message, left = client.result(stamp, "disparity", "left/enhanced/image")
    assert left.encoding == "mono8"
    found = 20.0 / depths(message)
    matched = np.isfinite(found)
    assert matched.mean() > 0.5
    assert np.median(np.abs(found - scene.disparity)[matched]) < 0.5
    # What grey cannot tell is not published but for what frames before it told,
    # and nothing of it is late.
    client.result(client.publish(*parts), *STAMPED)
    raw = [topic for topic in STAMPED if topic.startswith("visibility/raw/")]
    assert not any(client.has(topic, stamp) for topic in raw)


def flat(value: int) -> Callable[..., tuple[Any, Any, Any, Any]]:
    """Make frames whose pixels all have one value."""
    return lambda s, image, info: (
        image(np.full_like(s.left, value), "rgb8"), image(np.full_like(s.right, value), "rgb8"),
        info("left"), info("right"),
    )


BAD_INPUTS: dict[str, tuple[Callable[..., tuple[Any, Any, Any, Any]], str]] = {
    "calibration of another size": (
        lambda s, image, info: (
            image(s.left, "rgb8"), image(s.right, "rgb8"), info("left", width=80), info("right")
        ),
        "left image has 160x120 pixels and its camera_info 80x120",
    ),
    "truncated": (
        lambda s, image, info: (
            image(s.left, "rgb8", height=121), image(s.right, "rgb8"), info("left"), info("right")
        ),
        "the message is truncated",
    ),
    "black": (flat(0), "dark"),
}


@pytest.mark.parametrize("case", BAD_INPUTS)
def test_bad_frame_is_dropped_with_its_reason_and_the_next_is_processed(
    node: Any, client: Any, scene: Any, image: Any, info: Any, parts: Any, case: str
) -> None:
    make, reason = BAD_INPUTS[case]
    bad = client.publish(*make(scene, image, info))
    node.wait_for(reason)
    client.result(client.publish(*parts), *STAMPED)
    assert not any(client.has(topic, bad) for topic in STAMPED)
    assert "Traceback" not in node.log


def test_diagnostics_come_once_a_second(client: Any) -> None:
    # Most have come while the tests before were run.
    arrays = client.received["/diagnostics"]
    client.wait(lambda: len(arrays) > 5, "diagnostics")
    # One may be late where the machine is busy; most are not.
    gaps = np.diff([1e-9 * stamp for stamp in client.stamps("/diagnostics")])
    assert np.median(gaps) == pytest.approx(1.0, abs=0.3), gaps


# An interruption of a node that is ready is in the next test.
@pytest.mark.parametrize(("number", "ready"), [(signal.SIGTERM, True), (signal.SIGINT, False)])
def test_signal_ends_the_node_soon_and_quietly(
    start_node: Callable[..., Any], number: int, ready: bool
) -> None:
    node = start_node(ready=ready, fresh=not ready)
    node.wait_for("preparing the pipeline")
    code, seconds = node.stop(number)
    assert (code, "Traceback" in node.log) == (0, False), node.log
    assert seconds < LONGEST_END


def test_signal_ends_a_busy_node_soon(
    start_node: Callable[..., Any], make_client: Any, parts: Any
) -> None:
    node = start_node("-r", "__ns:=/busy")
    client = make_client(namespace="/busy")
    client.connect(*parts)
    for _ in range(5):
        client.publish(*parts)
    code, seconds = node.stop(signal.SIGINT)
    assert (code, "Traceback" in node.log) == (0, False), node.log
    assert seconds < LONGEST_END


@pytest.mark.parametrize(("arguments", "message"), [
    (("-p", "max_rnge:=3.0"), "unknown parameter max_rnge: did you mean max_range?"),
    (("-p", "max_range:=-3.0"), "parameter max_range is -3.0: give a value between"),
    (("-p", "camera.transfer:=gamma"), "camera.transfer is 'gamma': give one of linear, srgb"),
    (("-p", "camera.response:=/no/such.csv"), "/no/such.csv"),
    (("-p", "depth_frame:=''"), "parameter depth_frame is ''"),
    (("-p", "camera.flat_field:=/none.png"), "camera.flat_field: cannot read"),
    (
        ("-p", "qos_overrides./disparity.publisher.dept:=3"),
        "did you mean qos_overrides./disparity.publisher.depth?",
    ),
    (
        ("-p", "qos_overrides./disparity.publisher.reliability:=maybe"),
        "topic disparity cannot be made with its qos_overrides and remapping: Unexpected",
    ),
    (
        ("-r", "depth_sensor:=disparity"),
        "topic depth_sensor cannot be made with its qos_overrides and remapping: Failed to create",
    ),
    (("--params-file", "/no/such/file.yaml"), "/no/such/file.yaml"),
])
def test_bad_start_is_one_sentence_and_exit_code_2(
    start_node: Callable[..., Any], arguments: tuple[str, ...], message: str
) -> None:
    node = start_node(*arguments, ready=False, fresh="--params-file" in arguments)
    assert node.process.wait(timeout=60) == 2
    said = [line for line in node.log.splitlines() if line.startswith("uw_visibility: ")]
    assert len(said) == 1 and message in said[0], node.log
    assert "Traceback" not in node.log


def test_whole_numbers_and_files_are_understood_at_start(
    start_node: Callable[..., Any], tmp_path: Path
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    max_range: 30\n"
        "    camera:\n      white_reference: [1, 1, 2]\n"
    )
    shipped = Path(__file__).resolve().parents[2] / "config" / "uw_visibility.yaml"
    node = start_node("--params-file", str(shipped), "--params-file", str(file))
    assert node.stop()[0] == 0


PAIRS = 4


def test_recorded_raw_pairs_are_rectified_and_processed(
    start_node: Callable[..., Any], make_client: Callable[..., Any], shared_data: Path
) -> None:
    rosbags = pytest.importorskip("rosbags.highlevel", reason="rosbags is not installed")
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import CameraInfo, Image

    remappings = [
        part
        for side in ("left", "right")
        for name, source in (("image_rect", "image_raw"), ("camera_info", "camera_info"))
        for part in ("-r", f"{side}/{name}:=/stereo/{side}/{source}")
    ]
    node = start_node("-p", "rectify:=true", *remappings)
    names = {
        f"/stereo/{side}/{topic}": f"{side}/{name}"
        for side in ("left", "right")
        for name, topic in (("image", "image_raw"), ("camera_info", "camera_info"))
    }
    pairs: dict[int, dict[str, Any]] = {}
    with rosbags.AnyReader([shared_data / "underwater" / "bermuda_raw_bag"]) as reader:
        # All pairs are of one kind, and large: each takes a second.
        for connection, time, raw in itertools.islice(reader.messages(), 4 * PAIRS):
            kind = Image if "image" in connection.topic else CameraInfo
            message = deserialize_message(bytes(raw), kind)
            pairs.setdefault(time, {})[names[connection.topic]] = message
    frames = [
        tuple(p[n] for n in ("left/image", "right/image", "left/camera_info", "right/camera_info"))
        for p in pairs.values()
    ]
    assert len(frames) == PAIRS
    client = make_client({name: topic for topic, name in names.items()})
    client.connect(*frames[0])
    complete = []
    for frame in frames:
        stamp = client.publish(*frame)
        client.result(stamp, *IMAGES)
        disparity = client.result(stamp, "disparity")[0]
        assert disparity.f == pytest.approx(435.35213527586393)
        assert disparity.t == pytest.approx(0.06620494413054522)
        complete.append(stamp)
    # A board at half a metre, in water that shows some 20 m, says next to nothing of it.
    client.diagnosed("pipeline", str(Status.ATTENUATION_UNCERTAIN))
    assert not client.received["visibility/distance"], node.log
