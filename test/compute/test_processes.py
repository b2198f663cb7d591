# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What lies in the current folder is not run by the processes that the package starts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from uw_visibility.compute.processes import process_pool


def run(folder: Path, code: str, *words: str, **where: Path) -> subprocess.CompletedProcess[str]:
    """Run code from a file, as the installed command is: its own folder is searched."""
    (folder / "command.py").write_text(code, encoding="utf-8")
    return subprocess.run(
        [sys.executable, str(folder / "command.py"), *words], capture_output=True, text=True,
        check=False, timeout=60, **where)


POOL = """\
from uw_visibility.compute.processes import process_pool
if __name__ == "__main__":
    with process_pool(2, abs, -1) as pool:
        print(sum(pool.map(abs, (-1, -2))))
"""


def test_a_pool_imports_nothing_from_the_current_folder(
    hostile_folder: Path, tmp_path: Path
) -> None:
    done = run(tmp_path, POOL, cwd=hostile_folder)
    assert (done.stdout, done.returncode) == ("3\n", 0), done.stderr
    assert not (hostile_folder / "ran").exists()


@pytest.mark.parametrize("before", [None, "", "yes"])
def test_the_environment_is_as_before(before: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    if before is None:
        monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    else:
        monkeypatch.setenv("PYTHONSAFEPATH", before)
    with pytest.raises(ZeroDivisionError), process_pool(1, abs, -1):
        raise ZeroDivisionError
    assert os.environ.get("PYTHONSAFEPATH") == before


REFUSED = """\
import os, sys
from multiprocessing import util
from uw_visibility.compute.processes import process_pool
from uw_visibility.errors import InputError
start, started = util.spawnv_passfds, []
def refused(path, arguments, descriptors):
    if len(started) == 2:
        raise OSError(11, "Resource temporarily unavailable")
    number = start(path, arguments, descriptors)
    if "tracker" not in arguments[-1]:
        started.append(number)
    return number
if __name__ == "__main__":
    util.spawnv_passfds = refused
    try:
        with process_pool(3, abs, -1):
            print("begun")
    except InputError as error:
        print(error)
    print(*(os.waitid(os.P_PID, each, os.WEXITED | os.WNOWAIT).si_status for each in started))
"""


def test_what_cannot_be_started_is_told_and_the_others_end(tmp_path: Path) -> None:
    done = run(tmp_path, REFUSED)
    told, ended = done.stdout.splitlines()
    assert told.startswith("cannot start 3 processes, [Errno 11] Resource temporarily unavailable")
    assert told.endswith(": give fewer with --jobs")
    assert ended == f"{int(signal.SIGTERM)} {int(signal.SIGTERM)}"
    assert (done.stderr, done.returncode) == ("", 0)


INTERRUPTED = """\
import os, signal, sys, threading, time
from multiprocessing import util
from uw_visibility.compute.processes import process_pool
start = util.spawnv_passfds
def interrupted(path, arguments, descriptors):
    number = start(path, arguments, descriptors)
    if ("tracker" in arguments[-1]) == (sys.argv[1] == "tracker"):
        os.kill(os.getpid(), signal.SIGINT)
    return number
if __name__ == "__main__":
    util.spawnv_passfds = interrupted
    # One that takes signals, as numba's threads do.
    threading.Thread(target=time.sleep, args=(2.0,), daemon=True).start()
    with process_pool(2, abs, -1) as pool:
        print(sum(pool.map(abs, (-1, -2))))
"""


@pytest.mark.parametrize("which", ["tracker", "worker"])
def test_an_interruption_while_processes_start_ends_them_all_without_a_word(
    tmp_path: Path, which: str
) -> None:
    done = run(tmp_path, INTERRUPTED, which)
    assert (done.stdout, done.returncode) == ("", -signal.SIGINT)
    # This process's own, and no worker's.
    assert done.stderr.count("Traceback") == 1
    assert done.stderr.rstrip().endswith("KeyboardInterrupt")


WAITING = """\
import time
from uw_visibility.compute.processes import process_pool
if __name__ == "__main__":
    with process_pool(2, abs, -1) as pool:
        print(sum(pool.map(abs, (-1, -2))), flush=True)
        time.sleep(60.0)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_pool_ends_with_the_process_that_started_it(tmp_path: Path, number: int) -> None:
    (tmp_path / "command.py").write_text(WAITING, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "command.py")], stdout=subprocess.PIPE, text=True,
        stderr=subprocess.DEVNULL,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "3\n"
    process.send_signal(number)
    # The pool's processes hold the pipe open too, for as long as there are any.
    assert process.communicate(timeout=60) == ("", None)
