# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Results on a full disk, of two runs at once, and of runs that are ended by force."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from uw_visibility.cli import main
from uw_visibility.config.files import sole_writer
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.table import read_rows

FullDisk = Callable[[int], AbstractContextManager[None]]
SMALL = ["--frames", "2", "--width", "96", "--height", "72"]


def names(folder: Path) -> set[str]:
    return {entry.name for entry in folder.iterdir()}


def test_enhance_on_a_full_disk_leaves_the_result_of_before(
    pair: list[str], tmp_path: Path, full_disk: FullDisk, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["enhance", *pair, "-o", str(out)]) == 0
    before = {file: file.read_bytes() for file in out.iterdir()}
    capsys.readouterr()
    # Room for an image, and none for the maps.
    with full_disk(25_000):
        assert main(["enhance", *pair, "-o", str(out), "--force"]) == 2
    told = capsys.readouterr().err
    assert "cannot write" in told and str(out) in told
    assert {file: file.read_bytes() for file in out.iterdir()} == before


def test_simulate_on_a_full_disk_leaves_no_bag_and_not_less_than_before(
    tmp_path: Path, full_disk: FullDisk, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    command = ["simulate", "-o", str(bag), *SMALL]
    with full_disk(60_000):
        assert main(command) == 2
    assert f"cannot write bag {bag}" in capsys.readouterr().err
    assert not names(tmp_path)
    assert main(command) == 0
    with full_disk(60_000):
        assert main([*command, "--force"]) == 2
    with BagReader(bag) as reader:
        assert len(list(reader.messages(["/left/image_rect"]))) == 2
        assert not reader.damage
    assert names(tmp_path) == {"bag"}


def test_replay_on_a_full_disk_is_gone_on_from(
    recording: Path, tmp_path: Path, full_disk: FullDisk, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["replay", str(recording), "-o", str(out), "--jobs", "1"]
    with full_disk(150_000):
        assert main(command) == 2
    told = capsys.readouterr().err
    assert "cannot write" in told and "internal error" not in told
    assert names(tmp_path) == {"out.partial"}
    assert main([*command, "--resume"]) == 0
    assert len(list(read_rows(out / "frames.csv"))) == 4
    assert names(tmp_path) == {"out"}


@pytest.mark.parametrize("command", ["enhance", "simulate", "replay", "evaluate"])
def test_a_second_run_on_a_folder_is_told(
    command: str, pair: list[str], recording: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = {"enhance": pair, "simulate": SMALL, "replay": [str(recording), "--jobs", "1"],
             "evaluate": ["--quick"]}[command]
    out = tmp_path / "results" / "out"
    with sole_writer(out):
        assert main([command, *words, "-o", str(out)]) == 2
    assert f"another run writes {out}" in capsys.readouterr().err
    assert not out.exists() or not names(out)


def test_a_simulation_ended_by_force_leaves_no_bag_and_the_next_one_tidies_up(
    tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    command = [sys.executable, "-m", "uw_visibility.cli", "simulate", "-o", str(bag)]
    process = subprocess.Popen([*command, "--frames", "2000", *SMALL[2:]])
    end = time.monotonic() + 60.0
    while not list(tmp_path.glob(".bag.*/bag/bag.mcap")) and time.monotonic() < end:
        time.sleep(0.05)
    process.kill()
    process.wait()
    assert not bag.exists() and names(tmp_path)
    assert main(["simulate", "-o", str(bag), *SMALL]) == 0
    assert names(tmp_path) == {"bag"}


def test_a_killed_worker_is_said_and_the_replay_gone_on_from(
    recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    command = [
        sys.executable, "-m", "uw_visibility.cli", "replay", str(recording), "-o", str(out),
    ]
    process = subprocess.Popen([*command, "--jobs", "2"], stderr=subprocess.PIPE, text=True)
    worker = _child(process.pid)
    os.kill(worker, signal.SIGKILL)
    _, told = process.communicate(timeout=120)
    assert process.returncode == 2
    assert "ended from outside" in told and "Traceback" not in told
    assert main(["replay", str(recording), "-o", str(out), "--jobs", "1", "--resume"]) == 0
    assert json.loads((out / "replay.json").read_text())["frames"] == 4


def _child(parent: int) -> int:
    """Wait for a process that works on frames, and return its number."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        for entry in Path("/proc").iterdir():
            try:
                fields = (entry / "stat").read_text().rsplit(")", 1)[1].split()
                command = (entry / "cmdline").read_bytes()
            except (OSError, IndexError):
                continue
            if int(fields[1]) == parent and b"spawn_main" in command:
                return int(entry.name)
        time.sleep(0.05)
    raise AssertionError("no process was started")


def test_whoever_reads_the_output_may_stop_early(recording: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "uw_visibility.cli", "replay", str(recording), "--list"],
        stdout=write, stderr=subprocess.PIPE, text=True,
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (141, "")


def test_threads_of_one_process_share_no_folder(pair: list[str], tmp_path: Path) -> None:
    codes: list[int] = []

    def run() -> None:
        codes.append(main(["enhance", *pair, "-o", str(tmp_path / "out")]))

    with sole_writer(tmp_path / "out"):
        thread = threading.Thread(target=run)
        thread.start()
        thread.join()
    assert codes == [2]


def test_names_from_outside_are_shown_without_control_characters(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = Path(shutil.copytree(recording, tmp_path / "\x1b[2J\nforged"))
    file = next(bag.glob("*.mcap"))
    file.write_bytes(file.read_bytes().replace(b"/depth_sensor", b"\x1b]0;title\a\n/d"))
    (bag / "metadata.yaml").unlink()
    assert main(["replay", str(bag), "--list"]) == 0
    assert main(["replay", str(bag), "-o", str(tmp_path / "out"), "--jobs", "1"]) == 0
    assert main(["enhance", "\x1b[31mred.png", "r.png", "-o", str(tmp_path / "other")]) == 2
    said = "".join(capsys.readouterr())
    assert "title" in said and "forged" in said
    assert all(c.isprintable() or c == "\n" for c in said)
    assert "\nforged" not in said
    page = (tmp_path / "out" / "report.html").read_text()
    assert "forged" in page and "\x1b" not in page
