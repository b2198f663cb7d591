# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fast DDS settings for messages as large as images.

A process sends to others of its machine through shared memory of its own, by default 512 KiB
of it, which one image of 640x480 overruns. What finds no room is lost and, where it is
reliable, sent again when the heartbeat tells, which comes with the next image, or after three
seconds: an answer to a parameter's client, too, that has the bad luck to come behind an image.
So the node sends through more of it. How much a camera's driver has is not the node's to say,
and a processor that sleeps wakes too late to empty it in time; so the node receives through
sockets, whose memory is the receiver's.

The node does so itself, and not its launch file alone, since without it a camera that
publishes with best effort loses most of its pairs: test_node_large_images, 11 of 45 arrive.
"""

from __future__ import annotations

import os
from collections.abc import MutableMapping
from pathlib import Path

PROFILES_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
# With any of these somebody has set up the middleware already.
OTHER_VARIABLES = (
    "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS", "SKIP_DEFAULT_XML_FILE",
)
# Read by Fast DDS from the current folder.
LOCAL_FILE = "DEFAULT_FASTRTPS_PROFILES.xml"
PROFILES = Path(__file__).with_name("fastdds.xml")
# What Linux allows the memory of a socket to be, and what a pair of images needs, bytes.
SOCKET_MEMORY = Path("/proc/sys/net/core/rmem_max")
ENOUGH = 2 * 640 * 480 * 3


def give_memory(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Enlarge the memory of transport for images; to be called before `rclpy.init`.

    Nothing changes where the middleware was set up otherwise. Other middlewares do not
    read the variable.

    Parameters
    ----------
    environment : mutable mapping of str to str
        Of the process.

    Returns
    -------
    bool
        Whether the node's own profile is in use.
    """
    if any(environment.get(name) for name in (PROFILES_VARIABLE, *OTHER_VARIABLES)):
        return False
    if Path(LOCAL_FILE).exists() or not PROFILES.exists():
        return False
    environment[PROFILES_VARIABLE] = str(PROFILES)
    return True


def scarce_memory(allowed: Path = SOCKET_MEMORY) -> str:
    """Advice on sockets that have no room for a pair of images, or nothing.

    Parameters
    ----------
    allowed : Path
        File that holds how much memory a socket may have, bytes; absent but on Linux.
    """
    try:
        size = int(allowed.read_text(encoding="ascii"))
    except (OSError, ValueError):
        # Another system, or one that hides it: nothing is known to be wrong.
        return ""
    if size >= ENOUGH:
        return ""
    return (
        f"a socket may hold {size // 1024} KiB, less than a pair of images, which may come late: "
        "allow more, such as sysctl -w net.core.rmem_max=4194304"
    )
