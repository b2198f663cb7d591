# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The node ``uw_visibility`` as a managed one, whose states somebody else decides."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from uw_visibility.errors import InputError
from uw_visibility.ros.run import STOP_TIMEOUT, run

if TYPE_CHECKING:
    from uw_visibility.ros.core import NodeCore


class UwVisibilityLifecycleNode(LifecycleNode):
    """The same work as `uw_visibility.ros.node.UwVisibilityNode`, under a lifecycle.

    Configuring subscribes, advertises and compiles; only an active node takes
    images and publishes results.

    Raises
    ------
    InputError
        If a parameter that the node was started with cannot be used.
    """

    def __init__(self) -> None:
        super().__init__("uw_visibility")
        # Imported here: the middleware looks for others meanwhile, in threads of its own.
        from uw_visibility.ros.core import NodeCore
        from uw_visibility.ros.parameters import NodeParameters

        self._make_core = NodeCore
        self._node_parameters = NodeParameters(self)
        self._core: NodeCore | None = None

    def stop(self, timeout: float) -> bool:
        """End the work; returns whether it ended within the timeout (s)."""
        return self._core is None or self._core.stop(timeout)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make everything that the work needs."""
        try:
            self._core = self._make_core(self, self._node_parameters)
        except InputError as error:
            self.get_logger().error(f"cannot be configured: {error}")
            return TransitionCallbackReturn.FAILURE
        except Exception:
            # rclpy drops what a transition raises.
            self.get_logger().error(f"cannot be configured\n{traceback.format_exc()}")
            return TransitionCallbackReturn.ERROR
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin the work."""
        if self._core is not None:
            self._core.activate()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Pause the work."""
        if self._core is not None:
            self._core.deactivate()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give back what `on_configure` made."""
        self._give_back()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the work for good."""
        self._give_back()
        return super().on_shutdown(state)

    def _give_back(self) -> None:
        if self._core is not None:
            # A frame that is still being processed is published no more.
            self._core.stop(STOP_TIMEOUT)
            self._core.destroy()
            self._core = None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the managed node until it is told to stop; see `uw_visibility.ros.run.run`."""
    return run(UwVisibilityLifecycleNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
