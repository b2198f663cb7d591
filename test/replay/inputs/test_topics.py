# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Topics found by type and name, or given."""

from __future__ import annotations

import pytest

from uw_visibility.errors import InputError
from uw_visibility.replay.bags.storage import Channel
from uw_visibility.replay.inputs.topics import (
    COMPRESSED,
    IMAGE,
    INFO,
    Selection,
    Wanted,
    find_topics,
)

POSE, PRESSURE = "geometry_msgs/msg/PoseWithCovarianceStamped", "sensor_msgs/msg/FluidPressure"


def camera(folder: str, *images: str, kind: str = IMAGE, count: int = 9) -> dict[str, str]:
    """Return topics of a pair of cameras, under folder with {} for the side."""
    topics = {}
    for side in ("left", "right"):
        base = folder.format(side)
        topics |= {f"{base}/{image}": kind for image in images} | {f"{base}/camera_info": INFO}
    return topics


def find(
    topics: dict[str, str], *, rectify: bool = False, empty: tuple[str, ...] = (),
    sensor_type: str | None = None, **wanted: str,
) -> Selection:
    channels = {t: Channel(t, k, count=0 if t in empty else 9) for t, k in topics.items()}
    return find_topics(channels, Wanted(**wanted), rectify=rectify, sensor_type=sensor_type)


@pytest.mark.parametrize("folder", ["/stereo/{}", "/{}", "/auv/{}_camera", "/camera/{}/optical"])
def test_a_pair_is_found_by_left_and_right_in_the_names(folder: str) -> None:
    found = find(camera(folder, "image_rect"))
    left, right = folder.format("left"), folder.format("right")
    assert (found.left, found.right) == (f"{left}/image_rect", f"{right}/image_rect")
    assert (found.left_info, found.right_info) == (f"{left}/camera_info", f"{right}/camera_info")
    assert found.notes == []


def test_raw_or_rectified_colour_and_uncompressed_are_preferred_as_asked_for() -> None:
    topics = camera("/{}", "image_raw", "image_rect", "image_rect_mono")
    topics |= camera("/{}", "image_rect/compressed", kind=COMPRESSED)
    assert find(topics).left == "/left/image_rect"
    assert find(topics, rectify=True).left == "/left/image_raw"
    assert find(topics, rectify=True).rectify
    assert "used instead of" in find(topics).notes[0]
    compressed = camera("/{}", "image_rect/compressed", kind=COMPRESSED)
    found = find(compressed)
    assert (found.left, found.left_info) == ("/left/image_rect/compressed", "/left/camera_info")


def test_one_raw_and_one_compressed_image_are_a_pair() -> None:
    topics = camera("/{}", "image_rect")
    del topics["/right/image_rect"]
    topics["/right/image_rect/compressed"] = COMPRESSED
    for wanted in ({}, {"left": "/left/image_rect"}):
        found = find(topics, **wanted)
        assert (found.left, found.right) == ("/left/image_rect", "/right/image_rect/compressed")
        assert found.right_info == "/right/camera_info"
    with pytest.raises(InputError, match="no right image belongs"):
        find(topics | {"/front/image": IMAGE, "/front/image/compressed": COMPRESSED},
             left="/front/image")
    # Of the same transport if there is such a pair.
    topics["/left/image_rect/compressed"] = COMPRESSED
    found = find(topics, left="/left/image_rect/compressed")
    assert found.right == "/right/image_rect/compressed"
    found = find(topics | camera("/{}", "image_rect"))
    assert (found.left, found.right) == ("/left/image_rect", "/right/image_rect")


def test_what_is_rectified_by_its_name_is_not_rectified_again() -> None:
    """Raw and rectified recordings are replayed by one command."""
    found = find(camera("/{}", "image_rect"), rectify=True)
    assert not found.rectify
    assert found.notes == ["/left/image_rect is rectified by its name: it is not rectified again"]
    # A topic that is named is rectified, whatever its name.
    assert find(camera("/{}", "image_rect"), rectify=True, left="/left/image_rect").rectify
    assert not find(camera("/{}", "image_raw")).rectify


def test_what_is_no_camera_is_not_taken_for_one() -> None:
    topics = camera("/{}", "image_rect") | camera("/{}/enhanced", "image")
    topics |= camera("/{}", "depth/image") | {"/ground_truth/left/image": IMAGE}
    found = find(topics)
    assert (found.left, found.notes) == ("/left/image_rect", [])


def test_a_topic_without_messages_is_not_taken_before_one_with_some() -> None:
    topics = camera("/a/{}", "image_rect") | camera("/b/{}", "image_rect")
    assert find(topics, empty=("/a/left/image_rect",)).left == "/b/left/image_rect"


def test_given_topics_are_used_and_the_right_one_follows_from_the_left() -> None:
    topics = camera("/a/{}", "image_rect") | camera("/b/{}", "image_rect")
    topics |= {"/port/image": IMAGE, "/starboard/image": IMAGE}
    found = find(topics, left="/b/left/image_rect")
    assert (found.right, found.right_info) == ("/b/right/image_rect", "/b/right/camera_info")
    found = find(
        topics, left="/port/image", right="/starboard/image",
        left_info="/a/left/camera_info", right_info="/a/right/camera_info",
    )
    assert (found.left, found.right_info) == ("/port/image", "/a/right/camera_info")


@pytest.mark.parametrize("wanted, message", [
    ({"left": "a/left/image_rect"}, "there is no topic a/left/image_rect"),
    ({"left": "/front/image"}, "no right image belongs to /front/image"),
    ({"left": "/a/left/camera_info"}, "is a sensor_msgs/msg/CameraInfo"),
    ({"right": "/a/right/image_rect"}, "give both"),
    ({"left_info": "/a/left/image_rect"}, "is a sensor_msgs/msg/Image"),
    ({"depth": "/deep"}, "no topic /deep"),
])
def test_what_cannot_be_used_is_named(wanted: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        find(camera("/a/{}", "image_rect") | {"/front/image": IMAGE}, **wanted)


def test_no_pair_or_no_calibration_says_what_to_do() -> None:
    with pytest.raises(InputError, match="--left and --right; images are /front/image"):
        find({"/front/image": IMAGE})
    with pytest.raises(InputError, match="no /left/camera_info beside /left/image"):
        find({"/left/image": IMAGE, "/right/image": IMAGE})


def test_the_depth_sensor_is_found_by_its_type_and_name() -> None:
    topics = camera("/{}", "image_rect") | {
        "/ground_truth/depth": POSE, "/visibility/depth": POSE, "/auv/depth": POSE,
        "/auv/pressure": PRESSURE, "/auv/pose": POSE,
    }
    found = find(topics)
    assert (found.depth, found.sensor_type) == ("/auv/depth", "PoseWithCovarianceStamped")
    found = find(topics, sensor_type="FluidPressure")
    assert (found.depth, found.sensor_type) == ("/auv/pressure", "FluidPressure")
    assert find(topics, sensor_type="none").depth is None
    assert find(topics | {"/depth_sensor": POSE}).depth == "/depth_sensor"
    assert find(topics, depth="/auv/pose").depth == "/auv/pose"


def test_a_depth_sensor_with_values_is_preferred_to_one_without() -> None:
    topics = camera("/{}", "image_rect") | {"/depth_sensor": POSE, "/bar30/depth": POSE}
    found = find(topics, empty=("/depth_sensor",))
    assert found.depth == "/bar30/depth"
    assert found.notes == ["depth sensor /bar30/depth is used instead of /depth_sensor"]
    assert find(topics, empty=("/depth_sensor", "/bar30/depth")).depth == "/depth_sensor"
