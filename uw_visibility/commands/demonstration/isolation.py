# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Isolation of ROS traffic: on this machine, apart from other runs, without loss of images."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uw_visibility.errors import InputError

PROFILE = """\
<?xml version="1.0" encoding="UTF-8"?>
<!-- By default, Fast DDS hands messages over in 512 KiB of shared memory, which an image
     of 640x480 overruns: best-effort subscriptions, as nodes use them for images, then
     lose most of them. This gives it room for some tens of images, and keeps what goes
     through the network stack on this machine. -->
<profiles xmlns="http://www.eprosima.com">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>shared_memory</transport_id>
      <type>SHM</type>
      <segment_size>33554432</segment_size>
      <maxMessageSize>8388608</maxMessageSize>
    </transport_descriptor>
    <transport_descriptor>
      <transport_id>loopback</transport_id>
      <type>UDPv4</type>
      <interfaceWhiteList>
        <address>127.0.0.1</address>
      </interfaceWhiteList>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="this_machine" is_default_profile="true">
    <rtps>
      <userTransports>
        <transport_id>shared_memory</transport_id>
        <transport_id>loopback</transport_id>
      </userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
    </rtps>
  </participant>
</profiles>
"""


# Linux leaves the domains 0 to 101 free of ephemeral ports; 0 is everybody's.
DOMAINS = range(1, 100)
# Ports of a domain begin here (DDSI-RTPS 2.5, 9.6.2.3): the first participant's, UDP.
FIRST_PORT, PORTS_PER_DOMAIN = 7410, 250


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Reserve a ROS domain that no other run on this machine is in.

    Yields
    ------
    int
        The domain, which others that reserve one leave alone until the context ends.

    Raises
    ------
    InputError
        If none is free.
    """
    # Not all begin with the same one, since between the look and the start is a moment.
    first = os.getpid() % len(DOMAINS)
    for domain in (*DOMAINS[first:], *DOMAINS[:first]):
        port = FIRST_PORT + PORTS_PER_DOMAIN * domain
        # ROS has no use for the port of TCP, and the system frees it however this ends.
        with socket.socket() as mine, socket.socket(type=socket.SOCK_DGRAM) as participant:
            try:
                mine.bind(("127.0.0.1", port))
                participant.bind(("", port))
            except OSError:
                continue
            participant.close()
            yield domain
            return
    raise InputError("no ROS domain is free: all of 1 to 99 are in use on this machine")


def isolate(profile: Path) -> None:
    """Set this process's environment, and its children's, before ROS is started.

    Parameters
    ----------
    profile : Path
        XML file to write the settings of Fast DDS to.
    """
    profile.write_text(PROFILE, encoding="utf-8")
    os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile.resolve())
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.pop("ROS_STATIC_PEERS", None)
