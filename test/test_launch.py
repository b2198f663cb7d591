# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The launch files describe the node that their arguments and the parameter file ask for.

ROS on PyPI has no launch: what the files use of it is stood in for, unless it is installed.
"""

from __future__ import annotations

import re
import runpy
import sys
import types
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest

from uw_visibility.config.parameters import read_yaml

FOLDER = Path(__file__).resolve().parents[1]
FILE = FOLDER / "launch" / "uw_visibility.launch.py"


class Action:
    """Stands for an action of launch: keeps what it was made of."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.arguments = arguments
        self.options = options


class Configuration(Action):
    def perform(self, context: dict[str, str]) -> str:
        return context[self.arguments[0]]


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    names = {
        "ament_index_python.packages": {"get_package_share_path": lambda name: FOLDER},
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction"),
        "launch.substitutions": {"LaunchConfiguration": Configuration},
        "launch_ros.actions": ("LifecycleNode", "Node"),
    }
    for name, content in names.items():
        parts = name.split(".")
        for package in (".".join(parts[:end]) for end in range(1, len(parts))):
            if package not in names and package not in sys.modules:
                monkeypatch.setitem(sys.modules, package, types.ModuleType(package))
        members = content if isinstance(content, dict) else {
            member: type(member, (Action,), {}) for member in content
        }
        module = types.ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    return runpy.run_path(str(FILE))


def arguments(launch_file: dict[str, Any]) -> dict[str, str]:
    """Return the default of each launch argument."""
    (entities,) = launch_file["generate_launch_description"]().arguments
    return {
        e.arguments[0]: e.options["default_value"] for e in entities
        if type(e).__name__ == "DeclareLaunchArgument"
    }


def node(launch_file: dict[str, Any], **given: str) -> Any:
    """Return the node that arguments ask for."""
    (made,) = launch_file["make_node"](arguments(launch_file) | given)
    return made


def inputs(made: Any) -> set[str]:
    remappings = dict(made.options["remappings"])
    return {remappings[f"{side}/image_rect"] for side in ("left", "right")}


def test_defaults_leave_everything_to_the_parameter_file(launch_file: dict[str, Any]) -> None:
    made = node(launch_file)
    assert made.options["name"] == "uw_visibility"
    assert made.options["parameters"] == [str(FOLDER / "config" / "uw_visibility.yaml")]
    assert inputs(made) == {"left/image_rect", "right/image_rect"}
    assert made.options["respawn"] is False


@pytest.mark.parametrize(("block", "given", "source"), [
    ("/**", {}, "image_raw"),
    ("/auv/eyes", {"namespace": "/auv", "node_name": "eyes"}, "image_raw"),
    ("/auv/*", {"namespace": "auv"}, "image_raw"),
    ("/other", {}, "image_rect"),
    ("/**", {"rectify": "false"}, "image_rect"),
    ("/other", {"rectify": "true"}, "image_raw"),
])
def test_rectification_takes_the_raw_images_wherever_it_is_asked_for(
    launch_file: dict[str, Any], tmp_path: Path, block: str, given: dict[str, str], source: str
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(f"{block}:\n  ros__parameters:\n    rectify: true\n")
    made = node(launch_file, params_file=str(file), camera_namespace="/stereo", **given)
    assert inputs(made) == {f"/stereo/left/{source}", f"/stereo/right/{source}"}
    overridden = made.options["parameters"][1:]
    assert overridden == ([{"rectify": given["rectify"] == "true"}] if "rectify" in given else [])


def test_arguments_reach_the_node(launch_file: dict[str, Any]) -> None:
    made = node(
        launch_file, node_name="eyes", namespace="auv", use_sim_time="true", respawn="true",
        respawn_delay="0.5", image_transport="compressed", depth_sensor="/pressure",
    )
    options = made.options
    assert (options["name"], options["namespace"]) == ("eyes", "auv")
    assert (options["respawn"], options["respawn_delay"]) == (True, 0.5)
    assert options["parameters"][1] == {"use_sim_time": True, "image_transport": "compressed"}
    assert ("depth_sensor", "/pressure") in options["remappings"]


def test_managed_node_starts_itself_unless_told_not_to(launch_file: dict[str, Any]) -> None:
    for given, autostart in (({}, True), ({"autostart": "false"}, False)):
        made = node(launch_file, lifecycle="true", **given)
        assert made.options["executable"] == "uw_visibility_lifecycle_node"
        # A request of the launch file is lost to the process before, where that one crashed.
        assert made.options["parameters"][1] == {"autostart": autostart}


def test_of_several_parameter_files_a_later_one_wins(
    launch_file: dict[str, Any], tmp_path: Path
) -> None:
    files = [tmp_path / name for name in ("vehicle.yaml", "camera.yaml")]
    for file, value in zip(files, ("false", "true"), strict=True):
        file.write_text(f"/**:\n  ros__parameters:\n    rectify: {value}\n")
    made = node(launch_file, params_file=",".join(map(str, files)))
    assert made.options["parameters"] == [str(file) for file in files]
    assert inputs(made) == {"left/image_raw", "right/image_raw"}
    with pytest.raises(FileNotFoundError, match=r"params_file is /none\.yaml"):
        node(launch_file, params_file=f"{files[0]},/none.yaml")


def test_file_that_is_not_there_is_named(launch_file: dict[str, Any]) -> None:
    with pytest.raises(FileNotFoundError, match=r"params_file is /none\.yaml"):
        node(launch_file, params_file="/none.yaml")


def test_xml_hands_on_arguments_that_there_are(launch_file: dict[str, Any]) -> None:
    known = arguments(launch_file)
    root = ElementTree.parse(FILE.with_suffix(".xml")).getroot()
    declared = {arg.get("name"): arg.get("default") for arg in root.findall("arg")}
    handed = {arg.get("name"): arg.get("value") for arg in root.findall("include/arg")}
    assert declared.keys() == handed.keys() == known.keys()
    for name, value in handed.items():
        assert value == f"$(var {name})"
        assert name == "params_file" or declared[name] == known[name]


def test_bag_is_played_by_what_package_xml_names() -> None:
    text = (FOLDER / "launch" / "uw_visibility_bag.launch.py").read_text(encoding="utf-8")
    assert re.search(r'"ros2", "bag", "play"', text)
    package = (FOLDER / "package.xml").read_text(encoding="utf-8")
    for name in ("ros2launch", "ros2bag", "rosbag2_storage_default_plugins", "launch_xml"):
        assert f"<exec_depend>{name}</exec_depend>" in package


def test_names_of_a_parameter_file_are_those_of_ros(tmp_path: Path) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text("""
/**: {ros__parameters: {max_range: 1.0}}
/auv: {uw_visibility: {ros__parameters: {max_range: 2.0}}}
/*/other: {ros__parameters: {max_range: 3.0}}
uw_visibility: {ros__parameters: {max_range: 4.0}}
""")
    assert read_yaml(file, "/a/b/c") == {"max_range": 1.0}
    assert read_yaml(file, "/auv/uw_visibility") == {"max_range": 2.0}
    assert read_yaml(file, "/any/other") == {"max_range": 3.0}
    assert read_yaml(file, "/uw_visibility") == {"max_range": 4.0}


@pytest.mark.parametrize("file", sorted(FILE.parent.glob("*.launch.py")), ids=lambda f: f.name)
def test_launch_file_makes_a_description_of_launch_itself(file: Path) -> None:
    for name in ("launch", "launch_ros", "ament_index_python"):
        pytest.importorskip(name, reason=f"{name} is not among the ROS packages on PyPI")
    index = pytest.importorskip("ament_index_python.packages")
    try:
        index.get_package_share_path("uw_visibility")
    except index.PackageNotFoundError:
        pytest.skip("the package is not in an ament index: build it with colcon")
    description = runpy.run_path(str(file))["generate_launch_description"]()
    names = {argument.name for argument in description.get_launch_arguments()}
    assert names >= {"bag"} or names >= {"node_name", "respawn"}
