# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Every field of every outgoing message, for the message classes of rclpy and of rosbags."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.estimates import Estimate, ImageHeader
from uw_visibility.messages.frames import StereoFrame, StereoPair
from uw_visibility.messages.images import MessageFactory, read_image
from uw_visibility.messages.outputs import (
    DISPARITY_STEP,
    Source,
    all_topics,
    each_message,
    enhanced_sides,
)
from uw_visibility.pipeline.result import EnhancedImages, FrameResult, StereoResult
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Visibility
from uw_visibility.water.series.filter import FilteredWater
from uw_visibility.water.series.tracking import TrackingEvent

HEIGHT, WIDTH = 4, 40
RIG = StereoRig(400.0, 0.12, (19.5, 1.5), (16.5, 1.5))
TOPICS = all_topics(NodeConfig())
ESTIMATES = {topic for topic in TOPICS if topic.startswith("visibility/")}
RAW = {topic for topic in ESTIMATES if topic.startswith("visibility/raw/")}
CONFIG = NodeConfig(
    max_range=20.0, depth_frame="odom", publish_depth_image=True, publish_points=True
)
GENERATOR = np.random.default_rng(5)
LEFT, RIGHT = GENERATOR.integers(0, 256, (2, HEIGHT, WIDTH, 3), np.uint8)


@pytest.fixture(params=["rclpy", "rosbags"])
def make(request: pytest.FixtureRequest) -> MessageFactory:
    """Make messages of either library."""
    if request.param == "rclpy":
        pytest.importorskip("rclpy", reason="ROS is not installed")
        from uw_visibility.ros.transport.factory import make_message

        return make_message
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    from uw_visibility.replay.bags.decoder import jazzy_types

    return jazzy_types()[1]


def header(sec: int, frame_id: str) -> SimpleNamespace:
    return SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=250), frame_id=frame_id)


def frame() -> StereoFrame:
    images = [
        SimpleNamespace(header=header(sec, name))
        for sec, name in ((7, "left_camera"), (8, "right_camera"))
    ]
    infos = [
        SimpleNamespace(
            header=header(1, "elsewhere"), height=HEIGHT, width=WIDTH,
            distortion_model="plumb_bob", d=[0.1, 0.2, 0.3, 0.4, 0.5], k=np.arange(9.0),
            r=np.arange(9.0) + 1, p=np.arange(12.0) + n, binning_x=2, binning_y=3,
            roi=SimpleNamespace(x_offset=1, y_offset=2, width=3, height=4, do_rectify=True),
        )
        for n in (0, 100)
    ]
    return StereoFrame(*images, *infos)


def result(**changes: Any) -> FrameResult:
    covariance = np.diag([d**2 for s in (0.01, 0.02, 0.03) for d in (s, s / 2)])
    water = WaterEstimate(
        status=Status.OK, attenuation=np.array([0.5, 0.3, 0.2]),
        ambient_light=np.array([0.1, 0.4, 0.6]), covariance=covariance, iterations=9, bins=30,
        channel_status=(Status.OK,) * 3, envelope=None,
    )
    disparity = np.tile(np.linspace(0.0, 39.0, WIDTH, dtype=np.float32), (HEIGHT, 1))
    disparity[0, ::2] = np.nan
    fields: dict[str, Any] = {
        "water": water, "coarse_water": water,
        "visibility": Visibility(
            status=Status.OK, depth_status=Status.OK, mean_attenuation=0.25,
            mean_attenuation_stddev=0.01, distance=11.0, distance_stddev=0.5, depth=3.0,
            depth_stddev=0.25,
        ),
        "clear_water_attenuation": np.array([0.2, 0.1, 0.0]),
        "stereo": StereoResult(
            disparity=disparity, filled=disparity, range=disparity, filled_range=disparity,
            confidence=None, original=None, support_points=9, coverage=0.5,
            min_disparity=0, max_disparity=32, right_gain=np.ones(3),
        ),
        "images": EnhancedImages(LEFT, RIGHT, disparity > 1),
        "timing_ms": {"total": 1.0},
    }
    for group, names in (("stereo", ("disparity", "min_disparity")), ("images", ("left", "right"))):
        changed = {name: changes.pop(name) for name in names if name in changes}
        fields[group] = replace(fields[group], **changed)
    return FrameResult(**(fields | changes))


def visibility(**changes: Any) -> Visibility:
    return replace(result().visibility, **changes)


def build(
    make: MessageFactory, outcome: FrameResult | None = None, encoding: str = "rgb8",
    valid: np.ndarray | None = None, window: tuple[int, int, int, int] = (0, 0, WIDTH, HEIGHT),
    rig: StereoRig = RIG, filtered: FilteredWater | None = None,
) -> dict[str, Any]:
    pair = StereoPair(LEFT, RIGHT, rig, valid, window, (encoding, encoding))
    source = Source(make, frame(), pair, outcome or result(), CONFIG, filtered)
    return dict(each_message(source, all_topics(CONFIG)))


def head(message: Any) -> tuple[int, int, str]:
    stamp = message.header.stamp
    return stamp.sec, stamp.nanosec, message.header.frame_id


def disparities(message: Any) -> np.ndarray:
    image = message.image
    assert (image.encoding, image.is_bigendian) == ("32FC1", 0)
    assert (image.height, image.width, image.step) == (HEIGHT, WIDTH, 4 * WIDTH)
    return np.frombuffer(image.data, np.float32).reshape(HEIGHT, WIDTH)


def test_every_topic_has_its_message(make: MessageFactory) -> None:
    messages = build(make)
    topics = all_topics(CONFIG)
    assert list(messages) == list(topics)
    for topic, message in messages.items():
        assert type(message).__name__.endswith(topics[topic].rsplit("/", 1)[1])


def test_estimates_are_sent_before_what_is_large() -> None:
    topics = list(all_topics(CONFIG))
    assert set(topics[:len(ESTIMATES)]) == ESTIMATES


def test_messages_can_be_sent(make: MessageFactory) -> None:
    messages = build(make)
    if "rosbags" in type(messages["disparity"]).__module__:
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS2_JAZZY)
        for topic, name in all_topics(CONFIG).items():
            raw = store.serialize_cdr(messages[topic], name)
            assert store.deserialize_cdr(raw, name) is not None
    else:
        from rclpy.serialization import deserialize_message, serialize_message

        for message in messages.values():
            # The bytes that align fields hold anything, so the length is what repeats.
            raw = serialize_message(message)
            assert len(serialize_message(deserialize_message(raw, type(message)))) == len(raw)


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8"])
def test_enhanced_images_and_their_calibration(make: MessageFactory, encoding: str) -> None:
    messages = build(make, encoding=encoding)
    given = frame()
    for side, pixels, stamp, info in (
        ("left", LEFT, (7, 250, "left_camera"), given.left_info),
        ("right", RIGHT, (8, 250, "right_camera"), given.right_info),
    ):
        image = messages[f"{side}/enhanced/image"]
        assert (image.encoding, image.step, head(image)) == (encoding, 3 * WIDTH, stamp)
        np.testing.assert_array_equal(read_image(image), pixels)
        calibration = messages[f"{side}/enhanced/camera_info"]
        assert head(calibration) == stamp
        for name in ("d", "k", "r", "p"):
            np.testing.assert_array_equal(getattr(calibration, name), getattr(info, name))
        for name in ("height", "width", "distortion_model", "binning_x", "binning_y"):
            assert getattr(calibration, name) == getattr(info, name)
        for name in ("x_offset", "y_offset", "width", "height", "do_rectify"):
            assert getattr(calibration.roi, name) == getattr(info.roi, name)


def test_calibration_of_ros1_is_passed_on(make: MessageFactory) -> None:
    given = frame()
    for name in "dkrp":
        setattr(given.left_info, name.upper(), getattr(given.left_info, name))
        delattr(given.left_info, name)
    pair = StereoPair(LEFT, RIGHT, RIG, None, (0, 0, WIDTH, HEIGHT), ("rgb8", "rgb8"))
    source = Source(make, given, pair, result(), NodeConfig())
    ((_, info),) = each_message(source, ["left/enhanced/camera_info"])
    np.testing.assert_array_equal(info.p, np.arange(12.0))


def test_depth_follows_from_the_disparity_message_alone(make: MessageFactory) -> None:
    message = build(make)["disparity"]
    assert head(message) == head(message.image) == (7, 250, "left_camera")
    published = disparities(message)
    given = result().disparity
    assert np.isfinite(published).all()
    valid = published >= message.min_disparity
    searched = (given > RIG.offset) & (given <= 32.0)
    np.testing.assert_array_equal(valid, searched)
    expected = RIG.focal_length * RIG.baseline / (given[valid] - RIG.offset)
    depth = message.f * message.t / published[valid]
    resolution = expected**2 / (message.f * message.t) * message.delta_d
    assert (np.abs(depth - expected) <= 0.55 * resolution + 1e-5).all()


def test_limits_and_step_of_the_disparity_are_true(make: MessageFactory) -> None:
    message = build(make)["disparity"]
    published = disparities(message)
    valid = published[published >= message.min_disparity]
    assert (message.min_disparity, message.max_disparity) == (0.0, 32.0 - RIG.offset)
    assert valid.min() > 0.0 and valid.max() <= message.max_disparity
    assert np.array_equal(valid % message.delta_d, np.zeros_like(valid))
    assert (published[published < message.min_disparity] == message.min_disparity - 1).all()
    shifted = build(make, result(min_disparity=8))["disparity"]
    assert shifted.min_disparity == 8.0 - RIG.offset
    assert (disparities(shifted)[result().disparity < 8] < shifted.min_disparity).all()


def test_valid_window_holds_every_valid_pixel(make: MessageFactory) -> None:
    valid = np.zeros((HEIGHT, WIDTH), bool)
    valid[1:3, 10:30] = True
    message = build(make, valid=valid, window=(10, 1, 20, 2))["disparity"]
    published = disparities(message)
    np.testing.assert_array_equal(
        published >= message.min_disparity, valid & (result().disparity <= 32)
    )
    roi = message.valid_window
    assert (roi.x_offset, roi.y_offset, roi.width, roi.height) == (10, 1, 20, 2)
    assert roi.do_rectify is False


def test_valid_window_leaves_out_columns_without_a_partner(make: MessageFactory) -> None:
    roi = build(make, result(min_disparity=8))["disparity"].valid_window
    assert (roi.x_offset, roi.width) == (8, WIDTH - 8)


def test_visibility_distance(make: MessageFactory) -> None:
    message = build(make)["visibility/distance"]
    assert head(message) == (7, 250, "left_camera")
    assert (message.range, message.variance) == (11.0, 0.25)
    assert (message.min_range, message.max_range, message.radiation_type) == (0.0, 20.0, 1)
    assert message.field_of_view == pytest.approx(2 * math.atan(20 / 400))


def test_visibility_beyond_the_largest_range_is_infinite(make: MessageFactory) -> None:
    message = build(make, result(visibility=visibility(distance=20.1)))["visibility/distance"]
    assert (message.range, message.variance) == (math.inf, 0.0)


def test_water_per_channel(make: MessageFactory) -> None:
    messages = build(make)
    for topic, expected in (
        ("attenuation", [0.5, 0.3, 0.2]),
        ("attenuation_stddev", [0.01, 0.02, 0.03]),
        ("ambient_light", [0.1, 0.4, 0.6]),
    ):
        message = messages[f"visibility/{topic}"]
        assert head(message) == (7, 250, "left_camera")
        vector = message.vector
        np.testing.assert_allclose([vector.x, vector.y, vector.z], expected)
    assert messages["visibility/mean_attenuation"].data == 0.25
    stamped = messages["visibility/mean_attenuation_stamped"]
    assert head(stamped) == (7, 250, "left_camera")
    assert (stamped.vector.x, stamped.vector.y, stamped.vector.z) == (0.25, 0.01, 0.0)


def test_depth_is_negative_below_the_surface_and_only_z_is_measured(make: MessageFactory) -> None:
    message = build(make)["visibility/depth"]
    assert head(message) == (7, 250, "odom")
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    assert (position.x, position.y, position.z) == (0.0, 0.0, -3.0)
    assert (orientation.x, orientation.y, orientation.z, orientation.w) == (0.0, 0.0, 0.0, 1.0)
    covariance = np.array(message.pose.covariance).reshape(6, 6)
    assert covariance[2, 2] == 0.0625
    others = np.diag(covariance)[[0, 1, 3, 4, 5]]
    assert (others >= 1e6).all()
    assert np.count_nonzero(covariance - np.diag(np.diag(covariance))) == 0


@pytest.mark.parametrize(("camera", "given", "frame"), [
    ("left_camera_optical_frame", "", "left_camera_frame"), ("auv/left_optical", "", "auv/left"),
    ("left_camera_optical_link", "", "left_camera_link"), ("left_camera", "", "left_camera"),
    ("optical_rig/left", "", "optical_rig/left"), ("left_optical", "auv/nose", "auv/nose"),
])
def test_a_range_is_in_a_frame_whose_x_axis_points_ahead(
    make: MessageFactory, camera: str, given: str, frame: str
) -> None:
    """Viewers draw a Range along x, which is to the right in an optical frame (REP 103)."""
    estimate = Estimate(
        make, ImageHeader(7, 250, camera), result().water, result().visibility, 1.0,
        replace(CONFIG, distance_frame=given))
    assert head(estimate.message("distance")) == (7, 250, frame)
    assert head(estimate.message("attenuation")) == (7, 250, camera)


NAN = math.nan
UNKNOWN = {"mean_attenuation": NAN, "distance": NAN, "distance_stddev": NAN}


@pytest.mark.parametrize(("changes", "silent"), [
    (
        {"visibility": visibility(depth_status=Status.NO_COLOUR, depth=NAN, depth_stddev=NAN)},
        {"visibility/depth"},
    ),
    (
        {"visibility": visibility(status=Status.TOO_DARK, **UNKNOWN)},
        {
            "visibility/distance", "visibility/mean_attenuation",
            "visibility/mean_attenuation_stamped",
        },
    ),
    # Attenuation is known before the distance that follows from it is sure enough.
    (
        {"visibility": visibility(status=Status.RANGE_SPREAD_TOO_SMALL)},
        {"visibility/distance"},
    ),
    ({"visibility": visibility(depth_stddev=math.inf)}, {"visibility/depth"}),
    (
        {"water": replace(result().water, status=Status.SATURATED)},
        {
            f"visibility/{n}" for n in (
                "attenuation", "attenuation_stddev", "ambient_light", "mean_attenuation",
                "mean_attenuation_stamped")
        },
    ),
    # A channel that the water took is NaN in a vector that says the others.
    ({"water": replace(result().water, attenuation=np.array([NAN, 0.3, 0.2]))}, set()),
    (
        {"water": replace(result().water, attenuation=np.array([NAN, NAN, NAN]))},
        {"visibility/attenuation"},
    ),
])
def test_what_is_not_assessable_is_not_said(
    make: MessageFactory, changes: dict[str, Any], silent: set[str]
) -> None:
    raw = {topic.replace("visibility/", "visibility/raw/") for topic in silent}
    assert set(all_topics(CONFIG)) - set(build(make, result(**changes))) == silent | raw


def test_raw_estimates_are_the_frame_s_and_the_others_filtered_where_there_is_a_filter(
    make: MessageFactory,
) -> None:
    alone = build(make)
    for topic in RAW:
        assert str(alone[topic]) == str(alone[topic.replace("raw/", "")])
    filtered = FilteredWater(
        replace(result().water, attenuation=np.array([0.6, 0.4, 0.3])),
        visibility(mean_attenuation=0.35, distance=8.0, depth=4.0), TrackingEvent.UPDATED,
    )
    both = build(make, filtered=filtered)
    for topic in RAW:
        assert str(both[topic]) == str(alone[topic])
    assert both["visibility/attenuation"].vector.x == 0.6
    assert both["visibility/mean_attenuation"].data == 0.35
    assert both["visibility/distance"].range == 8.0
    assert both["visibility/depth"].pose.pose.position.z == -4.0


def test_what_the_filter_bridges_is_said_and_the_frame_s_own_is_not(make: MessageFactory) -> None:
    nothing = result(
        water=WaterEstimate.not_assessable(Status.NO_COLOUR),
        visibility=Visibility(Status.NO_COLOUR, Status.NO_COLOUR),
    )
    filtered = FilteredWater(result().water, result().visibility, TrackingEvent.PREDICTED)
    assert set(all_topics(CONFIG)) - set(build(make, nothing, filtered=filtered)) == RAW


def test_grey_images_stay_grey(make: MessageFactory) -> None:
    grey = result(left=LEFT[..., 0].copy(), right=RIGHT[..., 0].copy())
    image = build(make, grey, encoding="mono8")["left/enhanced/image"]
    assert (image.encoding, image.step) == ("mono8", WIDTH)


def test_only_what_is_wanted_is_made(make: MessageFactory) -> None:
    pair = StereoPair(LEFT, RIGHT, RIG, None, (0, 0, WIDTH, HEIGHT), ("rgb8", "rgb8"))
    # Making an image of None would fail.
    outcome = result(left=None, right=None)
    source = Source(make, frame(), pair, outcome, NodeConfig())
    assert {topic for topic, _ in each_message(source, ESTIMATES)} == ESTIMATES


def test_optional_outputs_are_off_by_default() -> None:
    assert set(all_topics(CONFIG)) - set(TOPICS) == {
        "depth/image", "depth/camera_info", "points2"
    }


def test_depth_image_is_in_metres_and_agrees_with_the_disparity(make: MessageFactory) -> None:
    messages = build(make)
    image, disparity = messages["depth/image"], messages["disparity"]
    assert head(image) == head(messages["depth/camera_info"]) == (7, 250, "left_camera")
    assert (image.encoding, image.step, image.width, image.height) == ("32FC1", 160, 40, 4)
    depth = np.frombuffer(image.data, np.float32).reshape(HEIGHT, WIDTH)
    published = disparities(disparity)
    valid = published >= disparity.min_disparity
    np.testing.assert_array_equal(np.isfinite(depth), valid)
    expected = disparity.f * disparity.t / published[valid]
    np.testing.assert_allclose(depth[valid], expected, rtol=1e-6)


@pytest.mark.parametrize("kind", ["rgb8", "rgb16", "mono8", "mono16"])
def test_points_project_onto_their_pixels_and_have_their_colours(
    make: MessageFactory, kind: str
) -> None:
    left = LEFT[..., 1].copy() if kind.startswith("mono") else LEFT
    if kind.endswith("16"):
        left = left.astype(np.uint16) * 256 + 255
    rig = replace(RIG, focal_length_y=300.0)
    messages = build(make, result(left=left, right=left), kind, rig=rig)
    cloud = messages["points2"]
    assert head(cloud) == (7, 250, "left_camera")
    assert (cloud.height, cloud.width, cloud.point_step) == (HEIGHT, WIDTH, 16)
    assert (cloud.row_step, len(cloud.data), cloud.is_dense) == (16 * WIDTH, 16 * 160, False)
    names = [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields]
    assert names == [("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1), ("rgb", 12, 7, 1)]
    values = np.frombuffer(cloud.data, np.float32).reshape(HEIGHT, WIDTH, 4)
    depth = np.frombuffer(messages["depth/image"].data, np.float32).reshape(HEIGHT, WIDTH)
    np.testing.assert_array_equal(values[..., 2], depth)
    rows, columns = np.nonzero(np.isfinite(depth))
    x, y, z = values[rows, columns, :3].T
    np.testing.assert_allclose(400 * x / z + rig.principal_point[0], columns, atol=1e-3)
    np.testing.assert_allclose(300 * y / z + rig.principal_point[1], rows, atol=1e-3)
    assert np.isnan(values[~np.isfinite(depth)][:, :3]).all()
    packed = np.frombuffer(cloud.data, np.uint32).reshape(HEIGHT, WIDTH, 4)[..., 3]
    colour = np.dstack([LEFT[..., 1]] * 3) if kind.startswith("mono") else LEFT
    for shift, channel in ((16, 0), (8, 1), (0, 2)):
        np.testing.assert_array_equal((packed >> shift) & 255, colour[..., channel])
    assert (packed >> 24 == 0).all()


@pytest.mark.parametrize(("topics", "sides"), [
    (ESTIMATES | {"disparity", "left/enhanced/camera_info", "depth/image"}, ()),
    ({"left/enhanced/image"}, ("left",)),
    ({"points2"}, ("left",)),
    ({"right/enhanced/image", "points2"}, ("left", "right")),
])
def test_images_are_enhanced_where_a_topic_shows_them(
    topics: set[str], sides: tuple[str, ...]
) -> None:
    assert enhanced_sides(topics) == sides


SHAPE = (4, 7)
DISPARITIES = arrays(
    np.float32, SHAPE,
    elements=st.one_of(st.just(float("nan")), st.floats(-20, 200, width=32)),
)
MASKS = arrays(np.bool_, SHAPE)


def source_of(
    disparity: np.ndarray, offset: float, least: int, valid: np.ndarray | None
) -> Source:
    """Make messages without a class from what was matched."""
    rig = StereoRig(400.0, 0.12, (19.5, 1.5), (19.5 - offset, 1.5))
    pair = StereoPair(LEFT, RIGHT, rig, valid, (0, 0, WIDTH, HEIGHT), ("rgb8", "rgb8"))
    found = result(disparity=disparity, min_disparity=least)
    return Source(lambda name, /, **fields: SimpleNamespace(**fields), frame(), pair, found, CONFIG)


@given(DISPARITIES, st.none() | MASKS, st.floats(-5, 5), st.integers(0, 50))
def test_published_disparity_is_rounded_and_within_its_limits(
    disparity: np.ndarray, valid: np.ndarray | None, offset: float, least: int
) -> None:
    source = source_of(disparity, offset, least, valid)
    offset, most = source.pair.rig.offset, source.result.stereo.max_disparity
    published, low, high = source.disparity
    assert (low, high) == (max(least - offset, 0.0), max(most - offset, low))
    limits = np.float32([low, high])
    steps = np.rint((disparity - np.float32(offset)) / np.float32(DISPARITY_STEP))
    rounded = (steps * DISPARITY_STEP).astype(np.float32)
    kept = (rounded > 0) & (rounded >= limits[0]) & (rounded <= limits[1])
    if valid is not None:
        kept &= valid
    np.testing.assert_array_equal(published, np.where(kept, rounded, limits[0] - 1))


