# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes: the only home of rclpy; topics, parameters, diagnostics, transport."""
