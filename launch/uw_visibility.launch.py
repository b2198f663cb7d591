# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Start the node, with its namespace, camera and parameter file from arguments."""

from __future__ import annotations

from typing import Any

from ament_index_python.packages import get_package_share_path
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

PACKAGE = "uw_visibility"


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the node."""
    parameters = get_package_share_path(PACKAGE) / "config" / "uw_visibility.yaml"
    return LaunchDescription([
        DeclareLaunchArgument(
            "namespace", default_value="", description="Namespace of the node.",
        ),
        DeclareLaunchArgument(
            "params_file", default_value=str(parameters), description="Parameter file.",
        ),
        DeclareLaunchArgument(
            "camera_namespace", default_value="",
            description="Namespace of the stereo camera, such as /stereo; that of the node where "
            "empty.",
        ),
        DeclareLaunchArgument(
            "rectify", default_value="false", choices=["true", "false"],
            description="Take image_raw instead of image_rect, and rectify it.",
        ),
        DeclareLaunchArgument(
            "use_sim_time", default_value="false", choices=["true", "false"],
            description="Take the time from /clock, as with ros2 bag play --clock.",
        ),
        DeclareLaunchArgument("log_level", default_value="info", description="Log level."),
        OpaqueFunction(function=make_node),
    ])


def make_node(context: LaunchContext) -> list[Any]:
    """Make the node from the values of the arguments."""
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    # What the file says holds unless an argument asks for more.
    switches = {name: True for name in ("rectify", "use_sim_time") if value(name) == "true"}
    camera = value("camera_namespace").rstrip("/")
    prefix = f"{camera}/" if value("camera_namespace") else ""
    image = "image_raw" if value("rectify") == "true" else "image_rect"
    return [
        Node(
            package=PACKAGE,
            executable="uw_visibility_node",
            name=PACKAGE,
            namespace=value("namespace"),
            parameters=[value("params_file"), *([switches] if switches else [])],
            remappings=[
                (f"{side}/{name}", f"{prefix}{side}/{source}")
                for side in ("left", "right")
                for name, source in (("image_rect", image), ("camera_info", "camera_info"))
            ],
            ros_arguments=["--log-level", value("log_level")],
            output="screen",
            emulate_tty=True,
        )
    ]
