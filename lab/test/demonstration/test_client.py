# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The link of the demonstration: joined and left without a word."""

from __future__ import annotations

import os
import threading
import time
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from rclpy.executors import SingleThreadedExecutor

from uw_visibility_lab.demonstration.client import open_link, with_stamp


def test_leaving_waits_for_the_collector(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    failures: list[Any] = []
    monkeypatch.setattr(threading, "excepthook", failures.append)
    looking = threading.Event()
    get_nodes = SingleThreadedExecutor.get_nodes

    def slow_get_nodes(executor: SingleThreadedExecutor) -> Any:
        # Between a look whether the executor goes on and what it then needs of it.
        looking.set()
        time.sleep(0.3)
        return get_nodes(executor)

    monkeypatch.setattr(SingleThreadedExecutor, "get_nodes", slow_get_nodes)
    with open_link(int(os.environ["ROS_DOMAIN_ID"]), {}, {}):
        assert looking.wait(20)
    assert failures == []
    assert not any(thread.name == "collector" for thread in threading.enumerate())


@pytest.mark.parametrize("little_endian", [True, False])
def test_a_stamp_is_replaced_in_either_byte_order(little_endian: bool) -> None:
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
    kind = "geometry_msgs/msg/PointStamped"
    types = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    made = types.types
    header = made["std_msgs/msg/Header"](made["builtin_interfaces/msg/Time"](1, 2), "camera")
    point = made[kind](header, made["geometry_msgs/msg/Point"](1.0, 2.0, 3.0))
    data = bytes(types.serialize_cdr(point, kind, little_endian=little_endian))
    message = types.deserialize_cdr(with_stamp(data, 5_000_000_006), kind)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (5, 6)
    assert message.header.frame_id == "camera"
    assert message.point.z == 3.0
