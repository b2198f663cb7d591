# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Entry points of the executables: they listen to signals before the node is imported."""

from __future__ import annotations

import importlib
import os
import signal

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
    code = int(importlib.import_module(module).main())
    # A second Ctrl-C, or that of the launcher after the terminal's, finds the interpreter
    # on its way out, where it would end the process as killed.
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    return code
