# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Subprocess of the node, which ends with the demonstration in every case."""

from __future__ import annotations

import os
import signal
import subprocess  # noqa: TID251
import sys
from pathlib import Path

from uw_visibility.compute.processes import SAFE_PATH
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
