# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the tests of the node have, for scripts: a node's process, a client and a scene."""

from __future__ import annotations

import importlib.util
import os
import sys
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType

from uw_visibility_lab.demonstration.node_process import reserved_domain

FOLDER = Path(__file__).resolve().parents[1]
SIDES = ("left", "right")
# Until this process ends.
RESERVED = ExitStack()


def load() -> ModuleType:
    """Load the tests' parts, in a ROS domain of this process's own."""
    name = "node_parts"
    if name not in sys.modules:
        sys.path.insert(0, str(FOLDER))
        # A test that starts this has one already.
        if "ROS_DOMAIN_ID" not in os.environ:
            os.environ["ROS_DOMAIN_ID"] = str(RESERVED.enter_context(reserved_domain()))
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        path = FOLDER / "ros" / "conftest.py"
        specification = importlib.util.spec_from_file_location(name, path)
        assert specification is not None and specification.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(sys.modules[name])
    return sys.modules[name]
