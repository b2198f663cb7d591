# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Isolation of ROS traffic: on this machine, apart from other runs, without loss of images."""

from __future__ import annotations

import os
from pathlib import Path

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


def isolate(profile: Path) -> int:
    """Set this process's environment, and its children's, before ROS is started.

    Parameters
    ----------
    profile : Path
        XML file to write the settings of Fast DDS to.

    Returns
    -------
    int
        A ROS domain of this process's own; Linux leaves the domains 0 to 101
        free of ephemeral ports.
    """
    profile.write_text(PROFILE, encoding="utf-8")
    os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile.resolve())
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.pop("ROS_STATIC_PEERS", None)
    return os.getpid() % 100 + 1
