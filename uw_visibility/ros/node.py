# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The node ``uw_visibility`` and its main function."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from uw_visibility.errors import InputError
from uw_visibility.ros.core import NodeCore

# How long the exit waits for the frame that is being processed, s.
STOP_TIMEOUT = 1.0


class UwVisibilityNode(Node):
    """Assesses the water, enhances the images and improves the disparity of stereo frames.

    Raises
    ------
    InputError
        If a parameter that the node was started with cannot be used.
    """

    def __init__(self) -> None:
        super().__init__("uw_visibility")
        self.core = NodeCore(self)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is told to stop.

    Parameters
    ----------
    arguments : sequence of str, optional
        Command line with ROS arguments; that of the process where absent.

    Returns
    -------
    int
        Exit code: 0 after Ctrl-C or SIGTERM, 2 where a parameter or argument
        cannot be used.
    """
    # rclpy's handlers stop the executor; Python's own would also raise
    # KeyboardInterrupt at a place of its choice.
    signal.signal(signal.SIGINT, lambda *_: None)
    signal.signal(signal.SIGTERM, lambda *_: None)
    try:
        rclpy.init(args=None if arguments is None else list(arguments))
    except Exception as error:
        return _refuse(error)
    try:
        node = UwVisibilityNode()
    except InputError as error:
        rclpy.try_shutdown()
        return _refuse(error)
    _spin(node)
    ended = node.core.stop(STOP_TIMEOUT)
    if not ended:
        _leave()
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


def _spin(node: UwVisibilityNode) -> None:
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        # The signal's way of ending spin.
        return


def _refuse(error: Exception) -> int:
    print(f"uw_visibility: {' '.join(str(error).split())}", file=sys.stderr)
    return 2


def _leave() -> None:
    """End the process while the worker is still computing, which cannot be interrupted."""
    rclpy.try_shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
