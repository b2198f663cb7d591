# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Header stamps of serialised messages, against rosbags' own serialisation."""

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed")

from rosbags.typesys import Stores, get_typestore

from uw_visibility.errors import InputError
from uw_visibility.messages.stamps import header_stamp

STAMP = 1_700_000_000_123_456_789
KIND = "geometry_msgs/msg/PointStamped"


def serialised(stamp, *, ros1=False, little_endian=True):
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    kinds = types.types
    time = kinds["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
    header = {"stamp": time, "frame_id": "camera"} | ({"seq": 7} if ros1 else {})
    message = kinds[KIND](
        kinds["std_msgs/msg/Header"](**header), kinds["geometry_msgs/msg/Point"](1.0, 2.0, 3.0))
    if ros1:
        return bytes(types.serialize_ros1(message, KIND))
    return bytes(types.serialize_cdr(message, KIND, little_endian=little_endian))


@pytest.mark.parametrize("little_endian", [True, False])
def test_a_stamp_is_read_in_either_byte_order(little_endian):
    assert header_stamp(serialised(STAMP, little_endian=little_endian)) == STAMP


def test_a_ros_1_header_begins_with_a_counter():
    assert header_stamp(serialised(STAMP, ros1=True), ros1=True) == STAMP


@pytest.mark.parametrize("ros1", [True, False])
@pytest.mark.parametrize("length", [0, 1, 11])
def test_a_message_that_ends_before_its_stamp_is_refused(ros1, length):
    with pytest.raises(InputError, match="ends before its stamp"):
        header_stamp(serialised(STAMP, ros1=ros1)[:length], ros1=ros1)
