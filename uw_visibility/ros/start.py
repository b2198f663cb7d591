# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Start of the node: environment of its process, and entry points of the executables."""

from __future__ import annotations

import importlib
import os
import signal
from collections.abc import Mapping

from uw_visibility.compute.threads import use_one_thread

# By default publishing waits for the middleware to send, and rclpy holds the interpreter's lock
# meanwhile: a slow network delays every callback. Read by rmw_fastrtps only.
PUBLICATION = {"RMW_FASTRTPS_PUBLICATION_MODE": "ASYNCHRONOUS"}


def node_environment(given: Mapping[str, str]) -> dict[str, str]:
    """Return environment variables to add to those that are `given`, which are kept."""
    return {name: value for name, value in PUBLICATION.items() if name not in given}


SIGNALS = (signal.SIGINT, signal.SIGTERM)


def node() -> int:
    """Run the node; returns the exit code."""
    return _start("uw_visibility.ros.node")


def lifecycle_node() -> int:
    """Run the managed node; returns the exit code."""
    return _start("uw_visibility.ros.lifecycle")


def _start(module: str) -> int:
    # Imports take seconds on a small computer; Ctrl-C would end them with a traceback.
    for number in SIGNALS:
        signal.signal(number, lambda *_: os._exit(0))
    use_one_thread()
    code = int(importlib.import_module(module).main())
    # A second signal, such as the launcher's after the terminal's, would kill the process while
    # the interpreter exits.
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    return code
