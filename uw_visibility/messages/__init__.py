# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""ROS messages to data and back, without rclpy: frames, synchroniser, outputs by topic."""
