# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Subprocess of the node, which ends with the demonstration in every case.

Its traffic is limited to this machine, separate from other runs, and loses no images.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess  # noqa: TID251
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from uw_visibility.compute.processes import SAFE_PATH
from uw_visibility.errors import InputError
from uw_visibility.ros.start import node_environment

COMMAND = (sys.executable, "-m", "uw_visibility.ros.node")
# Linux ends the node with the demonstration, even if the latter is killed (PR_SET_PDEATHSIG is 1);
# the setting remains when the node replaces this script.
_WITH_PARENT = """\
import ctypes, os, signal, sys
getattr(ctypes.CDLL(None), 'prctl', lambda *_: 0)(1, signal.SIGTERM)
if os.getppid() == int(sys.argv[1]):
    os.execv(sys.argv[2], sys.argv[2:])
"""
LAST_LINES = 15
PATIENCE = 10.0
PROFILE = Path(__file__).with_name("fastdds.xml")

# On Linux, ports of the domains 0 to 101 are not ephemeral ones; 0 is the default domain.
DOMAINS = range(1, 100)
# UDP port of the first participant in domain 0, and ports per domain (DDSI-RTPS 2.5, 9.6.2.3).
FIRST_PORT, PORTS_PER_DOMAIN = 7410, 250


class NodeDied(RuntimeError):
    """The node's process has ended; the message holds its last lines."""


class NodeProcess:
    """Context manager of the node's subprocess, whose output is appended to a file."""

    def __init__(self, log: Path, domain: int, command: tuple[str, ...] = COMMAND) -> None:
        self._log, self._domain, self._command = log, domain, command

    def __enter__(self) -> NodeProcess:
        environment = dict(
            os.environ, ROS_DOMAIN_ID=str(self._domain), PYTHONUNBUFFERED="1", **SAFE_PATH,
            **node_environment(os.environ),
        )
        with self._log.open("ab") as log:
            # In a session of its own, the node does not receive Ctrl-C of the
            # terminal: `__exit__` ends it, once, in every case.
            self._process = subprocess.Popen(
                (sys.executable, "-ISc", _WITH_PARENT, str(os.getpid()), *self._command),
                stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                env=environment, start_new_session=True,
            )
        return self

    @property
    def pid(self) -> int:
        """Process id of the node."""
        return self._process.pid

    def check(self) -> None:
        """Raise NodeDied, with the last lines of the log, if the node has ended."""
        code = self._process.poll()
        if code is None:
            return
        lines = self._log.read_text(encoding="utf-8", errors="replace").splitlines()
        last = "\n".join(f"  {line}" for line in lines[-LAST_LINES:])
        raise NodeDied(f"the node ended with exit code {code}; its last lines were\n{last}")

    def __exit__(self, *details: object) -> None:
        process = self._process
        if process.poll() is not None:
            return
        try:
            process.send_signal(signal.SIGINT)
            # A node that does not end in time is killed below.
            with suppress(subprocess.TimeoutExpired):
                process.wait(PATIENCE)
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Reserve a ROS domain that no other run on this machine is in, until the context ends."""
    # Runs begin at different domains, since there is some time between this check and the start.
    first = os.getpid() % len(DOMAINS)
    for domain in (*DOMAINS[first:], *DOMAINS[:first]):
        port = FIRST_PORT + PORTS_PER_DOMAIN * domain
        # The TCP port, which ROS does not use, marks the domain as taken; the system frees it.
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


def isolate() -> None:
    """Set the environment before ROS starts: Fast DDS profile, discovery on this machine only."""
    os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(PROFILE)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.pop("ROS_STATIC_PEERS", None)
