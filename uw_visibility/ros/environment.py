# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Environment variables that a launch file gives the node's process.

The C library gives large blocks back to the system when they are freed, so that each frame
has its pages cleared anew: for a cloud of points that takes longer than filling it
(test_environment). And the middleware sends within the call that publishes, during which
rclpy keeps the interpreter: a slow network or a full socket holds up every callback.
"""

from __future__ import annotations

from collections.abc import Mapping

# mallopt(3)
MEMORY = {
    # Free memory beyond this goes back to the system, bytes: all messages of a large frame.
    "MALLOC_TRIM_THRESHOLD_": str(128 << 20),
    # Larger blocks are the system's own in any case, bytes: the most that can be asked for.
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
}
# Of rmw_fastrtps, which others do not read.
PUBLICATION = {"RMW_FASTRTPS_PUBLICATION_MODE": "ASYNCHRONOUS"}


def node_environment(given: Mapping[str, str]) -> dict[str, str]:
    """Environment variables to add for the node.

    Parameters
    ----------
    given : mapping of str to str
        The environment; what it says of the C library's memory, or of how to publish, holds.
    """
    added: dict[str, str] = {}
    for variables, others in ((MEMORY, {"GLIBC_TUNABLES"}), (PUBLICATION, set())):
        if not given.keys() & (variables.keys() | others):
            added |= variables
    return added
