# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Start the node, plain or managed, with its namespace, camera and parameters from arguments."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_path
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node

from launch import LaunchContext, LaunchDescription
from uw_visibility.config.parameters import read_yaml
from uw_visibility.ros.start import node_environment

PACKAGE = "uw_visibility"
SWITCH = ["", "true", "false"]


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the node."""
    parameters = get_package_share_path(PACKAGE) / "config" / "uw_visibility.yaml"
    return LaunchDescription([
        DeclareLaunchArgument(
            "namespace", default_value="", description="Namespace of the node.",
        ),
        DeclareLaunchArgument(
            "node_name", default_value=PACKAGE, description="Name of the node.",
        ),
        DeclareLaunchArgument(
            "params_file", default_value=str(parameters),
            description="Parameter file, or several with commas; a later one wins.",
        ),
        DeclareLaunchArgument(
            "camera_namespace", default_value="",
            description="Namespace of the stereo camera, such as /stereo; that of the node where "
            "empty.",
        ),
        DeclareLaunchArgument(
            "rectify", default_value="", choices=SWITCH,
            description="Take image_raw instead of image_rect, and rectify it; as params_file "
            "says where empty.",
        ),
        DeclareLaunchArgument(
            "image_transport", default_value="", choices=["", "raw", "compressed"],
            description="Take Image messages, or CompressedImage on the topics + /compressed; as "
            "params_file says where empty.",
        ),
        DeclareLaunchArgument(
            "depth_sensor", default_value="depth_sensor",
            description="Topic of the depth sensor; see plausibility.sensor_type.",
        ),
        DeclareLaunchArgument(
            "use_sim_time", default_value="", choices=SWITCH,
            description="Take the time from /clock, as with ros2 bag play --clock; as params_file "
            "says where empty.",
        ),
        DeclareLaunchArgument(
            "lifecycle", default_value="false", choices=SWITCH[1:],
            description="Start a managed node, which somebody configures and activates.",
        ),
        DeclareLaunchArgument(
            "autostart", default_value="true", choices=SWITCH[1:],
            description="The managed node configures and activates itself, after a crash too.",
        ),
        DeclareLaunchArgument(
            "respawn", default_value="false", choices=SWITCH[1:],
            description="Start the node again when its process has ended.",
        ),
        DeclareLaunchArgument(
            "respawn_delay", default_value="2.0", description="Time until then, s.",
        ),
        DeclareLaunchArgument("log_level", default_value="info", description="Log level."),
        OpaqueFunction(function=make_node),
    ])


def make_node(context: LaunchContext) -> list[Any]:
    """Make the node from the values of the arguments."""
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    files = [name.strip() for name in value("params_file").split(",")]
    for name in files:
        # The node would be started without it, with no more than a warning.
        if not Path(name).is_file():
            raise FileNotFoundError(
                f"params_file is {name}, which is no file: name a parameter file, or several with "
                "commas"
            )
    # What the files say holds unless an argument says otherwise.
    overrides: dict[str, Any] = {
        name: value(name) == "true" for name in ("rectify", "use_sim_time") if value(name)
    }
    if value("image_transport"):
        overrides["image_transport"] = value("image_transport")
    full_name = "/".join(["", *value("namespace").strip("/").split("/"), value("node_name")])
    given: dict[str, Any] = {}
    for name in files:
        given |= read_yaml(name, full_name.replace("//", "/"))
    given |= overrides
    image = "image_raw" if given.get("rectify") else "image_rect"
    prefix = f"{value('camera_namespace').rstrip('/')}/" if value("camera_namespace") else ""
    managed = value("lifecycle") == "true"
    if managed:
        overrides["autostart"] = value("autostart") == "true"
    return [(LifecycleNode if managed else Node)(
        package=PACKAGE,
        executable="uw_visibility_lifecycle_node" if managed else "uw_visibility_node",
        name=value("node_name"),
        namespace=value("namespace"),
        parameters=[*files, *([overrides] if overrides else [])],
        remappings=[
            *(
                (f"{side}/{name}", f"{prefix}{side}/{source}")
                for side in ("left", "right")
                for name, source in (("image_rect", image), ("camera_info", "camera_info"))
            ),
            ("depth_sensor", value("depth_sensor")),
        ],
        ros_arguments=["--log-level", value("log_level")],
        additional_env=node_environment(os.environ),
        respawn=value("respawn") == "true",
        respawn_delay=float(value("respawn_delay")),
        output="screen",
        emulate_tty=True,
    )]
