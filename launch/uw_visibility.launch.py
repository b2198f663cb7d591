# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Start the node, plain or managed, with its namespace, camera and parameters from arguments."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_path
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessStart
from launch.events import matches_action
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition

from launch import LaunchContext, LaunchDescription
from uw_visibility.config.parameters import read_yaml
from uw_visibility.ros.environment import node_environment

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
            "params_file", default_value=str(parameters), description="Parameter file.",
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
            description="Configure and activate the managed node at once.",
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

    # The node would be started without it, with no more than a warning.
    if not Path(value("params_file")).is_file():
        raise FileNotFoundError(
            f"params_file is {value('params_file')}, which is no file: name a parameter file"
        )
    # What the file says holds unless an argument says otherwise.
    overrides: dict[str, Any] = {
        name: value(name) == "true" for name in ("rectify", "use_sim_time") if value(name)
    }
    if value("image_transport"):
        overrides["image_transport"] = value("image_transport")
    full_name = "/".join(["", *value("namespace").strip("/").split("/"), value("node_name")])
    given = read_yaml(value("params_file"), full_name.replace("//", "/")) | overrides
    image = "image_raw" if given.get("rectify") else "image_rect"
    prefix = f"{value('camera_namespace').rstrip('/')}/" if value("camera_namespace") else ""
    managed = value("lifecycle") == "true"
    node = (LifecycleNode if managed else Node)(
        package=PACKAGE,
        executable="uw_visibility_lifecycle_node" if managed else "uw_visibility_node",
        name=value("node_name"),
        namespace=value("namespace"),
        parameters=[value("params_file"), *([overrides] if overrides else [])],
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
    )
    return [*autostart(node), node] if managed and value("autostart") == "true" else [node]


def autostart(node: LifecycleNode) -> list[Any]:
    """Configure a managed node when it has started, and activate it when it is configured."""
    def change(transition: int) -> EmitEvent:
        return EmitEvent(event=ChangeState(
            lifecycle_node_matcher=matches_action(node), transition_id=transition,
        ))

    return [
        RegisterEventHandler(OnProcessStart(
            target_action=node, on_start=[change(Transition.TRANSITION_CONFIGURE)],
        )),
        RegisterEventHandler(OnStateTransition(
            target_lifecycle_node=node, start_state="configuring", goal_state="inactive",
            entities=[change(Transition.TRANSITION_ACTIVATE)],
        )),
    ]
