# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Node ``uw_visibility`` and its main function."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rclpy.node import Node

from uw_visibility.ros.run import run


class UwVisibilityNode(Node):
    """Node that assesses the water, enhances images and improves the disparity of stereo frames."""

    def __init__(self) -> None:
        super().__init__("uw_visibility")
        # Imported here: the middleware's threads discover other nodes meanwhile.
        from uw_visibility.ros.core import NodeCore
        from uw_visibility.ros.monitor import FaultLog, publish_diagnostics
        from uw_visibility.ros.parameters import NodeParameters

        self.faults = FaultLog(self)
        self._core = NodeCore(self, NodeParameters(self))
        publish_diagnostics(self, self._core.diagnose, self.faults)
        self._core.activate()

    def stop(self, timeout: float) -> bool:
        """Stop the worker; return whether it ended within the timeout (s)."""
        return self._core.stop(timeout)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until a signal ends it; see `uw_visibility.ros.run.run`."""
    return run(UwVisibilityNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
