# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Start of the node: environment of its process, and entry points of the executables."""

from __future__ import annotations

import importlib
import os
import signal
from collections.abc import Mapping

from uw_visibility.compute.threads import use_one_thread

# The C library gives large blocks back to the system when they are freed, and each frame has its
# pages cleared anew: for a cloud of points that takes longer than filling it. See mallopt(3).
MEMORY = {
    # Free memory beyond this goes back to the system, bytes: all messages of a large frame.
    "MALLOC_TRIM_THRESHOLD_": str(128 << 20),
    # Larger blocks are the system's own in any case, bytes: the most that can be asked for.
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
}
# By default the middleware sends within the call that publishes, and rclpy keeps the interpreter
# meanwhile: a slow network holds up every callback. Read by rmw_fastrtps only.
PUBLICATION = {"RMW_FASTRTPS_PUBLICATION_MODE": "ASYNCHRONOUS"}


def node_environment(given: Mapping[str, str]) -> dict[str, str]:
    """Return environment variables to add for the node; those that are `given` hold."""
    added: dict[str, str] = {}
    for variables, others in ((MEMORY, {"GLIBC_TUNABLES"}), (PUBLICATION, set())):
        if not given.keys() & (variables.keys() | others):
            added |= variables
    return added


SIGNALS = (signal.SIGINT, signal.SIGTERM)


def node() -> int:
    """Run the node; returns the exit code."""
    return _start("uw_visibility.ros.node")


def lifecycle_node() -> int:
    """Run the managed node; returns the exit code."""
    return _start("uw_visibility.ros.lifecycle")


def _start(module: str) -> int:
    # Importing takes seconds on a small computer, in which Ctrl-C would end in a traceback.
    for number in SIGNALS:
        signal.signal(number, lambda *_: os._exit(0))
    use_one_thread()
    code = int(importlib.import_module(module).main())
    # A second Ctrl-C, or that of the launcher after the terminal's, finds the interpreter
    # on its way out, where it would end the process as killed.
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    return code
