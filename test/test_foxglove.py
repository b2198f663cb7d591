# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The layout for Foxglove shows topics and fields that exist, each in a panel that can."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.depth_sensor import SENSOR_TYPES
from uw_visibility.messages.outputs import all_topics

FILE = Path(__file__).resolve().parents[1] / "foxglove" / "uw_visibility.json"

TOPICS = all_topics(NodeConfig(publish_depth_image=True, publish_points=True)) | {
    "left/image_rect": "sensor_msgs/msg/Image",
    "left/camera_info": "sensor_msgs/msg/CameraInfo",
    "depth_sensor": SENSOR_TYPES[NodeConfig().plausibility.sensor_type],
    "depth_plausibility/nis": "std_msgs/msg/Float64",
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
# What the panels of the layout can show; these are names of Foxglove's.
PANELS = {"Image", "3D", "Plot", "DiagnosticSummary"}


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    return dict(json.loads(FILE.read_text(encoding="utf-8")))


def panels(tree: Any) -> Iterator[str]:
    """Yield the panels of a layout's tree, whose branches must be whole."""
    if isinstance(tree, str):
        yield tree
        return
    assert tree["direction"] in ("row", "column")
    assert 0 < tree.get("splitPercentage", 50) < 100
    yield from panels(tree["first"])
    yield from panels(tree["second"])


def kind(topic: str) -> str:
    return TOPICS[topic.removeprefix("/")].rsplit("/", 1)[1]


def test_layout_has_every_part_and_every_panel_a_place(layout: dict[str, Any]) -> None:
    assert set(layout) == {
        "configById", "globalVariables", "userNodes", "playbackConfig", "layout"
    }
    placed = list(panels(layout["layout"]))
    assert sorted(placed) == sorted(layout["configById"])
    assert {name.partition("!")[0] for name in placed} == PANELS


def test_images_are_images_with_their_calibration(layout: dict[str, Any]) -> None:
    for name, config in layout["configById"].items():
        if name.startswith("Image!"):
            mode = config["imageMode"]
            assert kind(mode["imageTopic"]) == "Image"
            assert kind(mode["calibrationTopic"]) == "CameraInfo"
            assert Path(mode["imageTopic"]).parent == Path(mode["calibrationTopic"]).parent


def test_the_command_of_the_page_gives_a_layout_for_a_namespace(layout: dict[str, Any]) -> None:
    page = FILE.parents[1] / "docs" / "start" / "robot.md"
    (script,) = re.findall(
        r"^sed '(.*)' foxglove/uw_visibility\.json", page.read_text(), flags=re.M)
    done = subprocess.run(
        ["sed", script, str(FILE)], capture_output=True, text=True, check=True)

    def moved(value: Any) -> Any:
        if isinstance(value, dict):
            return {moved(key): moved(each) for key, each in value.items()}
        if isinstance(value, list):
            return [moved(each) for each in value]
        topic = isinstance(value, str) and value.startswith("/") and value != "/diagnostics"
        return f"/auv{value}" if topic else value

    assert json.loads(done.stdout) == moved(layout)


def test_other_panels_show_what_they_can(layout: dict[str, Any]) -> None:
    for name, config in layout["configById"].items():
        if name.startswith("3D!"):
            assert [kind(topic) for topic in config["topics"]] == ["PointCloud2"]
        if name.startswith("DiagnosticSummary!"):
            assert kind(config["topicToRender"]) == "DiagnosticArray"


def test_plotted_fields_exist_and_have_the_time_that_is_asked_for(layout: dict[str, Any]) -> None:
    pytest.importorskip("rclpy", reason="ROS is not installed")
    from uw_visibility.ros.transport.factory import message_type

    paths = [
        path for name, config in layout["configById"].items() if name.startswith("Plot!")
        for path in config["paths"]
    ]
    assert len(paths) >= 7
    for path in paths:
        topic, *fields = re.split(r"\.", path["value"])
        value = message_type(TOPICS[topic.removeprefix("/")])()
        assert (path["timestampMethod"] == "headerStamp") == hasattr(value, "header"), path
        for field in fields:
            value = getattr(value, field)
        assert isinstance(value, float), path
