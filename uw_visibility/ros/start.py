# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The executables of the package: they listen to signals before the node is imported."""

from __future__ import annotations

import importlib
import os
import signal


def node() -> int:
    """Run the node; returns the exit code."""
    return _start("uw_visibility.ros.node")


def lifecycle_node() -> int:
    """Run the managed node; returns the exit code."""
    return _start("uw_visibility.ros.lifecycle")


def _start(module: str) -> int:
    # Importing takes seconds on a small computer, in which Ctrl-C would end in a traceback.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    return int(importlib.import_module(module).main())
