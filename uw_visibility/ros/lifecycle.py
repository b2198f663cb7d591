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
from uw_visibility.ros.monitor import ERROR, OK, WARN, Finding
from uw_visibility.ros.run import STOP_TIMEOUT, run

if TYPE_CHECKING:
    from uw_visibility.messages.frames import StereoFrame
    from uw_visibility.ros.core import NodeCore
    from uw_visibility.ros.worker import NewestWorker


class UwVisibilityLifecycleNode(LifecycleNode):
    """Managed node with the function of `uw_visibility.ros.node.UwVisibilityNode`.

    Configuring subscribes, advertises and compiles; only an active node accepts
    images and publishes results. With the parameter `autostart` the node configures
    and activates itself when its process starts, such as again after a crash.
    """

    def __init__(self) -> None:
        super().__init__("uw_visibility")
        # Imported here: the middleware's threads discover other nodes meanwhile.
        from uw_visibility.ros.core import NodeCore
        from uw_visibility.ros.monitor import FaultLog, publish_diagnostics
        from uw_visibility.ros.parameters import NodeParameters

        self.faults = FaultLog(self)
        self._make_core = NodeCore
        self._node_parameters = NodeParameters(self)
        self._core: NodeCore | None = None
        # Why the last configuration failed, or "".
        self._refusal = ""
        # Workers still busy after a clean-up, such as compiling; an exit does not wait for them.
        self._unfinished: list[NewestWorker[StereoFrame]] = []
        self._change = self._service_change_state.callback
        self._service_change_state.callback = self._change_or_refuse
        publish_diagnostics(self, self._diagnose, self.faults)
        # The node does it itself: after a crash, a request may be sent to the dead process.
        if (
            self._node_parameters.settings.node.autostart
            and self.trigger_configure() is TransitionCallbackReturn.SUCCESS
        ):
            self.trigger_activate()

    def stop(self, timeout: float) -> bool:
        """Stop all workers; return whether they ended within the timeout (s)."""
        ended = self._core is None or self._core.stop(timeout)
        self._unfinished = [worker for worker in self._unfinished if not worker.stop(0.0)]
        return ended and not self._unfinished

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create topics, timers and worker."""
        return self._do(self._configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._do(self._working_core.activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._do(self._working_core.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Destroy what `on_configure` created, so that the node can be configured again."""
        return self._do(self._destroy_core)

    on_shutdown = on_error = on_cleanup

    @property
    def _working_core(self) -> NodeCore:
        if self._core is None:
            raise RuntimeError("the node is not configured")
        return self._core

    def _configure(self) -> None:
        self._destroy_core()
        self._unfinished = [worker for worker in self._unfinished if not worker.stop(0.0)]
        self._core = self._make_core(self, self._node_parameters)
        self._refusal = ""

    def _destroy_core(self) -> None:
        if self._core is None:
            return
        core, self._core = self._core, None
        # The result of a frame still in process is not published.
        if not core.stop(STOP_TIMEOUT):
            self._unfinished.append(core.worker)
        core.destroy()
        del core
        release_memory()
        # rclpy's callback groups keep dead weak references to destroyed entities.
        group = self.default_callback_group
        group.entities = {entity for entity in group.entities if entity() is not None}

    def _do(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        """Run a transition; report exceptions, which rclpy would discard."""
        try:
            work()
        except InputError as error:
            self._refusal = f"cannot be configured: {error}"
            self.get_logger().error(self._refusal)
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.faults.add(error)
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _change_or_refuse(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Answer a request for a transition; rclpy alone would end the node at an invalid one."""
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
        if self._refusal:
            finding = Finding(ERROR, f"{label}: {self._refusal}")
        return {"lifecycle": finding} | dict(self._core.diagnose() if self._core else {})


def release_memory() -> None:
    """Return unused memory to the system after a clean-up.

    Each thread frees memory into its own malloc arena: without this, every new worker would
    leave the memory of one frame allocated.
    """
    # The objects form reference cycles, which only the garbage collector frees.
    gc.collect()
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except AttributeError:
        # The C library is not glibc.
        return
    trim(0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the managed node until a signal ends it; see `uw_visibility.ros.run.run`."""
    return run(UwVisibilityLifecycleNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
