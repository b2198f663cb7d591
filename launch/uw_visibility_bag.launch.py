# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Example: play a recorded bag into the node, at the time of the recording.

``ros2 launch uw_visibility uw_visibility_bag.launch.py bag:=FOLDER
camera_namespace:=/stereo rectify:=true``
"""

from __future__ import annotations

from ament_index_python.packages import get_package_share_path
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription

PACKAGE = "uw_visibility"


def generate_launch_description() -> LaunchDescription:
    """Describe the bag's player and the node; the node's other arguments are passed on."""
    node = get_package_share_path(PACKAGE) / "launch" / "uw_visibility.launch.py"
    return LaunchDescription([
        DeclareLaunchArgument("bag", description="Folder of the bag."),
        DeclareLaunchArgument("rate", default_value="1.0", description="Speed of the player."),
        DeclareLaunchArgument(
            "delay", default_value="10.0",
            description="Time for the node to start before the bag does, s.",
        ),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(node)),
            launch_arguments={"use_sim_time": "true"}.items(),
        ),
        ExecuteProcess(
            cmd=[
                "ros2", "bag", "play", LaunchConfiguration("bag"), "--clock",
                "--rate", LaunchConfiguration("rate"), "--delay", LaunchConfiguration("delay"),
            ],
            output="screen",
        ),
    ])
