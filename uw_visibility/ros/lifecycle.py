# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Managed (lifecycle) node ``uw_visibility``."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from uw_visibility.errors import InputError, printable
from uw_visibility.ros.monitor import OK, WARN, Finding
from uw_visibility.ros.run import STOP_TIMEOUT, run

if TYPE_CHECKING:
    from uw_visibility.messages.frames import StereoFrame
    from uw_visibility.ros.core import NodeCore
    from uw_visibility.ros.worker import NewestWorker


class UwVisibilityLifecycleNode(LifecycleNode):
    """Managed node with the work of `uw_visibility.ros.node.UwVisibilityNode`.

    Configuring subscribes, advertises and compiles; only an active node takes
    images and publishes results. With the parameter `autostart` it does both when
    its process starts, so that one that crashed and was started again goes on.
    """

    def __init__(self) -> None:
        super().__init__("uw_visibility")
        # Imported here: the middleware looks for others meanwhile, in threads of its own.
        from uw_visibility.ros.core import NodeCore
        from uw_visibility.ros.monitor import DiagnosticsPublisher, FaultLog
        from uw_visibility.ros.parameters import NodeParameters

        self.faults = FaultLog(self)
        self._make_core = NodeCore
        self._node_parameters = NodeParameters(self)
        self._core: NodeCore | None = None
        # Of those that were cleaned up while they compiled, say: an exit must not wait for them.
        self._unfinished: list[NewestWorker[StereoFrame]] = []
        self._change = self._service_change_state.callback
        self._service_change_state.callback = self._change_or_refuse
        DiagnosticsPublisher(self, self._diagnose, self.faults)
        # Nobody's request does it: after a crash one may be sent to the process that has died.
        if (
            self._node_parameters.settings.node.autostart
            and self.trigger_configure() is TransitionCallbackReturn.SUCCESS
        ):
            self.trigger_activate()

    def stop(self, timeout: float) -> bool:
        """End the work; returns whether it ended within the timeout (s)."""
        ended = self._core is None or self._core.stop(timeout)
        self._unfinished = [worker for worker in self._unfinished if not worker.stop(0.0)]
        return ended and not self._unfinished

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make everything that the work needs."""
        return self._do(self._configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._do(self._working_core.activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._do(self._working_core.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release what `on_configure` allocated, so that the node can be configured again."""
        return self._do(self._give_back)

    on_shutdown = on_error = on_cleanup

    @property
    def _working_core(self) -> NodeCore:
        if self._core is None:
            raise RuntimeError("the node is not configured")
        return self._core

    def _configure(self) -> None:
        self._give_back()
        self._unfinished = [worker for worker in self._unfinished if not worker.stop(0.0)]
        self._core = self._make_core(self, self._node_parameters)

    def _give_back(self) -> None:
        if self._core is None:
            return
        core, self._core = self._core, None
        # A frame that is still being processed is published no more.
        if not core.stop(STOP_TIMEOUT):
            self._unfinished.append(core.worker)
        core.destroy()
        del core
        release_memory()
        # rclpy's groups keep a reference to whatever was destroyed.
        group = self.default_callback_group
        group.entities = {entity for entity in group.entities if entity() is not None}

    def _do(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        """Do the work of a transition; rclpy would drop what it raises."""
        try:
            work()
        except InputError as error:
            self.get_logger().error(f"cannot be configured: {error}")
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.faults.add(error)
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _change_or_refuse(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Answer a request; rclpy lets one that the state does not allow end the node."""
        try:
            return self._change(request, response)
        except rclpy_implementation.RCLError:
            wanted = printable(request.transition.label or request.transition.id)
            self.get_logger().warning(
                f"no transition {wanted} from the state {self._state_machine.current_state[1]}"
            )
            response.success = False
            return response

    def _diagnose(self) -> Mapping[str, Finding]:
        label = self._state_machine.current_state[1]
        finding = Finding(OK if label == "active" else WARN, label)
        return {"lifecycle": finding} | dict(self._core.diagnose() if self._core else {})


def release_memory() -> None:
    """Return unused memory to the system, as after a clean-up.

    Each thread frees into an arena of its own, so that without this every new worker would
    leave one frame's memory behind.
    """
    # What the work consists of refers to one another, so that counting alone frees nothing.
    gc.collect()
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except AttributeError:
        # Another C library than glibc.
        return
    trim(0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the managed node until it is told to stop; see `uw_visibility.ros.run.run`."""
    return run(UwVisibilityLifecycleNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
