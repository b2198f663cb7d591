# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Processes that begin where one has imported already what takes long.

To import numba and let it register what it compiles takes a process a second, and a node all
of its modules besides. Tests of what a process does later fork theirs from one that has done
so; tests of the start itself start Python.
"""

from __future__ import annotations

import atexit
import gc
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


class Forked:
    """A process, as `subprocess.Popen` has it."""

    def __init__(self, parent: Prepared, pid: int) -> None:
        self._parent = parent
        self.pid = pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Return the exit code, or None while the process runs."""
        if self.returncode is None:
            self.returncode = self._parent.ask(wait=self.pid)
        return self.returncode

    def wait(self, timeout: float = 60.0) -> int:
        """Wait for the end of the process; return its exit code."""
        end = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > end:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout)
            time.sleep(0.005)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless the process has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End the process at once."""
        self.send_signal(signal.SIGKILL)


class Prepared:
    """A process that runs some code, and is forked then by each process that starts."""

    def __init__(self, preparation: str, environment: Mapping[str, str]) -> None:
        self._lock = threading.Lock()
        # What is forked must have one thread, and OpenBLAS starts its own when it is loaded.
        self._process = subprocess.Popen(
            [sys.executable, "-P", __file__, preparation], text=True,
            env={"OPENBLAS_NUM_THREADS": "1", **environment},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )
        atexit.register(self.close)

    def ask(self, **request: Any) -> Any:
        """Hand a request to the process, and return its answer."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with self._lock:
            print(json.dumps(request), file=self._process.stdin, flush=True)
            return json.loads(self._process.stdout.readline())

    def start(
        self, code: str, arguments: Sequence[str] = (), *, environment: Mapping[str, str],
        cwd: Path, output: Path, errors: Path | None = None, path: Sequence[Path] = (),
    ) -> Forked:
        """Run code in a process; modules come from the folders of `path` first."""
        for file in (output, errors or output):
            file.touch()
        return Forked(self, self.ask(
            code=code, arguments=list(arguments), environment=dict(environment), cwd=str(cwd),
            output=str(output), errors=str(errors or output), path=list(map(str, path))))

    def close(self) -> None:
        """End the process and those that it has started."""
        atexit.unregister(self.close)
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(60)
        self._process.stdout.close()


def serve() -> str:
    """Answer requests; return the code to run, in each process that is started."""
    # Ctrl-C in a terminal is for those who ask.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    exec(sys.argv[1], {"__name__": "preparation"})
    # A thread would be missing from what is forked, with whatever it holds.
    assert len(list(Path("/proc/self/task").iterdir())) == 1
    # What is there need not be looked through, and copied, when a process ends.
    gc.collect()
    gc.freeze()
    running: set[int] = set()
    for line in sys.stdin:
        request, answer = json.loads(line), None
        if "wait" in request:
            pid, status = os.waitpid(request["wait"], os.WNOHANG)
            if pid:
                running.discard(pid)
                answer = os.waitstatus_to_exitcode(status)
        else:
            answer = os.fork()
            if not answer:
                return begin(request)
            running.add(answer)
        print(json.dumps(answer), flush=True)
    for pid in running:
        os.kill(pid, signal.SIGKILL)
    return ""


def begin(request: dict[str, Any]) -> str:
    """Make this process one that Python has started anew; return the code to run."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.chdir(request["cwd"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.dont_write_bytecode = "PYTHONDONTWRITEBYTECODE" in os.environ
    sys.argv[:] = ["-c", *request["arguments"]]
    sys.path[:0] = request["path"]
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(os.open(request["output"], flags), 1)
    os.dup2(os.open(request["errors"], flags), 2)
    return str(request["code"])


if __name__ == "__main__":
    exec(serve(), {"__name__": "__main__"})
