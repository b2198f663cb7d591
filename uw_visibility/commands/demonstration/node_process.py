# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Subprocess of the node, which ends with the demonstration in every case.

Its traffic stays on this machine, apart from other runs, without loss of images.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess  # noqa: TID251
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uw_visibility.compute.processes import SAFE_PATH
from uw_visibility.errors import InputError
from uw_visibility.ros.environment import node_environment

COMMAND = (sys.executable, "-m", "uw_visibility.ros.node")
# Linux ends the node with the demonstration, also where that is killed and ends nothing itself
# (PR_SET_PDEATHSIG is 1); it stays so when the node takes the place of this script.
_WITH_PARENT = """\
import ctypes, os, signal, sys
getattr(ctypes.CDLL(None), 'prctl', lambda *_: 0)(1, signal.SIGTERM)
if os.getppid() == int(sys.argv[1]):
    os.execv(sys.argv[2], sys.argv[2:])
"""
LAST_LINES = 15
PATIENCE = 10.0
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


class NodeDied(RuntimeError):
    """The node's process has ended; the message holds its last lines."""


class NodeProcess:
    """Subprocess of the node; to be used in a ``with`` statement.

    Parameters
    ----------
    log : Path
        File for what the node prints.
    domain : int
        ROS domain that the node is in.
    command : tuple of str
        What to run.
    """

    def __init__(self, log: Path, domain: int, command: tuple[str, ...] = COMMAND) -> None:
        self._log = log
        self._domain = domain
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> NodeProcess:
        environment = dict(
            os.environ, ROS_DOMAIN_ID=str(self._domain), PYTHONUNBUFFERED="1", **SAFE_PATH,
            **node_environment(os.environ),
        )
        with self._log.open("wb") as log:
            # In a session of its own, Ctrl-C in the terminal does not reach the
            # node: it is ended here, once, whatever ends the demonstration.
            self._process = subprocess.Popen(
                (sys.executable, "-ISc", _WITH_PARENT, str(os.getpid()), *self._command),
                stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                env=environment, start_new_session=True,
            )
        return self

    def check(self) -> None:
        """Raise if the node is no longer there.

        Raises
        ------
        NodeDied
            With the last lines that it printed.
        """
        code = None if self._process is None else self._process.poll()
        if code is None:
            return
        lines = self._log.read_text(encoding="utf-8", errors="replace").splitlines()
        last = "\n".join(f"  {line}" for line in lines[-LAST_LINES:])
        raise NodeDied(f"the node ended with exit code {code}; its last lines were\n{last}")

    def __exit__(self, *details: object) -> None:
        process = self._process
        if process is None or process.poll() is not None:
            return
        try:
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            # It does not listen: what follows ends it.
            pass
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()


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
