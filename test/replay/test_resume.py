# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""An interrupted replay is gone on from, by what it is a part of and nothing else."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from bag_copies import (
    DARK,
    DIVE_FRAMES,
    HARD_PARAMETERS,
    messages_of,
    parameter_file,
    run,
)
from made_once import leave_out_figures

from uw_visibility.cli import main
from uw_visibility.config.files import aside_of
from uw_visibility.replay import frame_log
from uw_visibility.replay.results import provenance
from uw_visibility.replay.results.folder import ResultFolder
from uw_visibility.replay.results.recorder import FrameRecorder
from uw_visibility.replay.table import read_rows
from uw_visibility.replay.work import RecordingProcessor

# After the frame without a result, and once the sensor's bias is learned.
INTERRUPTED_AT = 5


@dataclass
class Interrupted:
    """A replay that was interrupted, and how it was started."""

    bag: Path
    out: Path
    params: str
    code: int
    err: str

    @property
    def partial(self) -> Path:
        return self.out.with_name("out.partial")

    def again(self, *options: str, bag: Path | None = None, **rest: Any) -> SimpleNamespace:
        return run(bag or self.bag, self.out, "--params-file", self.params, *options, **rest)


def stop_at(number: int, method: Callable[..., Any]) -> Callable[..., Any]:
    """Let a method of a frame end in Ctrl-C at one of them."""
    def stopping(self: Any, item: Any, *more: Any) -> Any:
        frame = item.frame.number if hasattr(item, "frame") else item.record.frame
        if frame == number:
            raise KeyboardInterrupt
        return method(self, item, *more)

    return stopping


@pytest.fixture(scope="module")
def original(hard: Path, tmp_path_factory: pytest.TempPathFactory) -> Interrupted:
    """A replay that Ctrl-C has ended; tests have copies of it."""
    folder = tmp_path_factory.mktemp("interrupted")
    params = parameter_file(folder / "p.yaml", HARD_PARAMETERS)
    started = Interrupted(hard, folder / "results" / "out", params, 0, "")
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patched, contextlib.redirect_stderr(said):
        # As plain_report does, which serves single tests.
        leave_out_figures(patched, "report.report")
        patched.setattr(
            RecordingProcessor, "answer", stop_at(INTERRUPTED_AT, RecordingProcessor.answer)
        )
        started.code = started.again().code
    started.err = said.getvalue()
    return started


@pytest.fixture
def interrupted(original: Interrupted, tmp_path: Path) -> Interrupted:
    """A replay that Ctrl-C has ended, to be changed and gone on from."""
    shutil.copytree(original.out.parent, tmp_path / "results")
    return replace(original, out=tmp_path / "results" / "out")


def check_complete(interrupted: Interrupted, replayed: Path) -> None:
    """Check that a result is that of a replay that nobody interrupted."""
    out = interrupted.out
    assert (out / "frames.csv").read_bytes() == (replayed / "frames.csv").read_bytes()
    assert messages_of(out) == messages_of(replayed)
    with (out / "timings.csv").open() as file, (replayed / "timings.csv").open() as other:
        assert [r["frame"] for r in csv.DictReader(file)] == [
            r["frame"] for r in csv.DictReader(other)]
    assert {p.name for p in out.parent.iterdir()} == {"out"}
    assert {p.name for p in out.iterdir()} == {p.name for p in replayed.iterdir()}
    state = json.loads((out / "replay.json").read_text())
    assert (state["complete"], state["frames"]) == (True, DIVE_FRAMES)
    assert "Partial result" not in (out / "report.html").read_text()


def test_an_interruption_leaves_a_readable_part_marked_as_such(
    interrupted: Interrupted, hard_replayed: Path
) -> None:
    assert (interrupted.code, interrupted.out.exists()) == (130, False)
    rows = list(read_rows(interrupted.partial / "frames.csv"))
    assert rows == list(read_rows(hard_replayed / "frames.csv"))[: len(rows)]
    said = "out.partial: --resume continues it"
    assert said in interrupted.err
    # The last one or two wait for the sensor's value after them.
    assert INTERRUPTED_AT - 2 <= len(rows) <= INTERRUPTED_AT
    shown = [m for m in messages_of(interrupted.partial) if m[0] == "/disparity"]
    assert len(shown) == INTERRUPTED_AT - 1
    assert "Partial result" in (interrupted.partial / "report.html").read_text()
    assert not json.loads((interrupted.partial / "replay.json").read_text())["complete"]
    # In the file itself too, which may be handed on without the folder.
    assert b"uw_visibility.complete: 'false'" in (
        interrupted.partial / "results.mcap").read_bytes()


@pytest.mark.parametrize("crashed", [False, True])
def test_a_resumed_replay_is_as_if_it_had_not_been_interrupted(
    crashed: bool, interrupted: Interrupted, hard_replayed: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if crashed:
        # Nothing was closed: the messages have no end, the last row is cut off.
        folder = interrupted.partial
        (folder / "results").mkdir()
        data = (folder / "results.mcap").read_bytes()
        (folder / "results" / "results.mcap").write_bytes(data[: 2 * len(data) // 3])
        (folder / "results.mcap").unlink()
        table = (folder / "frames.csv").read_text()
        (folder / "frames.csv").write_text(table[:-40])
    assert interrupted.again().code == 2
    assert "--resume continues it" in capsys.readouterr().err
    done = interrupted.again("--resume", capsys=capsys)
    assert done.code == 0
    kept = int(done.out.split(" of them from before")[0].rpartition(" ")[2])
    assert (1 if crashed else INTERRUPTED_AT - 2) <= kept < INTERRUPTED_AT
    check_complete(interrupted, hard_replayed)


def test_frames_that_the_part_holds_less_of_than_it_says_are_worked_on_again(
    interrupted: Interrupted, hard_replayed: Path
) -> None:
    path = interrupted.partial / frame_log.NAME
    lines = path.read_text().splitlines(keepends=True)
    assert len(lines) == INTERRUPTED_AT
    # One is missing in the middle, and the last one is cut off.
    path.write_text("".join(lines[:1] + lines[2:-1]) + lines[-1][:-9])
    assert interrupted.again("--resume").code == 0
    check_complete(interrupted, hard_replayed)


def test_a_log_that_is_none_is_refused_and_nothing_of_it_is_executed(
    interrupted: Interrupted, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    class Harmful:
        def __reduce__(self) -> Any:
            return Path.touch, (tmp_path / "executed",)

    path = interrupted.partial / frame_log.NAME
    for content in (pickle.dumps(Harmful()) + b"\n", b"[1, 2]\n", b'{"float": "0x1p0"}\n'):
        path.write_bytes(content)
        capsys.readouterr()
        assert interrupted.again("--resume").code == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert "frames.jsonl, line 1, is not a frame of a replay: --force starts over" in line
    assert not (tmp_path / "executed").exists()


def test_of_two_parts_the_longer_one_is_gone_on_from(
    interrupted: Interrupted, hard_replayed: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = (interrupted.partial / "frames.csv").read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(FrameRecorder, "write_frame", stop_at(1, FrameRecorder.write_frame))
        assert interrupted.again("--resume").code == 130
    assert (interrupted.partial / "frames.csv").read_bytes() == before
    with monkeypatch.context() as patched:
        patched.setattr(
            RecordingProcessor, "answer", stop_at(DIVE_FRAMES - 2, RecordingProcessor.answer)
        )
        assert interrupted.again("--resume").code == 130
    assert len((interrupted.partial / "frames.csv").read_bytes()) > len(before)
    capsys.readouterr()
    assert f"{DIVE_FRAMES - 3} of them from" in interrupted.again("--resume", capsys=capsys).out
    check_complete(interrupted, hard_replayed)


@pytest.mark.parametrize("resume", [False, True])
def test_a_part_that_a_crash_while_going_on_left_aside_is_not_forgotten(
    resume: bool, tmp_path: Path
) -> None:
    for name in ("out.partial", "out.partial.old"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "frames.csv").write_text(name)
        (tmp_path / name / "replay.json").write_text("{}")
    folder = ResultFolder(tmp_path / "out", resume=resume, force=not resume)
    assert [entry.name for entry in folder.work.iterdir()] == ["replay.json"]
    if resume:
        # The newer part has not taken all of it over.
        assert folder.earlier is not None
        assert (folder.earlier / "frames.csv").read_text() == "out.partial.old"
        folder.forget_earlier()
    folder.complete()
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("options, difference", [
    (["--every", "2"], "replay.every"),
    (["--start", "0.5"], "replay.start"),
    (["--duration", "3"], "replay.duration"),
    (["--match-original"], "replay.match_original"),
    (["--left", "/left/image_rect"], "replay.left"),
    (["--depth-sensor", "/depth_sensor"], "replay.depth"),
    (["--rectify"], "rectify"),
])
def test_a_part_made_with_other_options_is_not_gone_on_from(
    options: list[str], difference: str, interrupted: Interrupted,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = {p.name: p.read_bytes() for p in interrupted.partial.iterdir()}
    done = interrupted.again("--resume", *options, capsys=capsys)
    assert done.code == 2
    assert f"out.partial was made with another {difference}: --force starts over" in done.err
    assert {p.name: p.read_bytes() for p in interrupted.partial.iterdir()} == before


@pytest.mark.parametrize("completed", [False, True], ids=["killed", "closed"])
def test_a_run_that_was_ended_by_force_before_its_first_frame_begins_anew(
    interrupted: Interrupted, capsys: pytest.CaptureFixture[str], completed: bool
) -> None:
    (interrupted.partial / "replay.json").write_text("")
    # There are frames in it, of which nothing tells what they were made from.
    assert "cannot go on from" in interrupted.again("--resume", capsys=capsys).err
    first = {
        "frames.csv", "frames.csv-metadata.json", "frames.jsonl", "results.mcap", "replay.json"}
    (interrupted.partial / "replay.json").touch()
    for entry in interrupted.partial.iterdir():
        if entry.name in first:
            entry.write_bytes(b"")
        elif entry.is_file():
            entry.unlink()
        else:
            shutil.rmtree(entry)
    assert {entry.name for entry in interrupted.partial.iterdir()} == first
    if not completed:
        # The recording is in a folder of its own until it is closed.
        (interrupted.partial / "results").mkdir()
        (interrupted.partial / "results.mcap").rename(
            interrupted.partial / "results" / "results.mcap")
    # It was ended while it wrote the table's dictionary.
    aside_of(interrupted.partial / "frames.csv-metadata.json").write_bytes(b"{")
    assert interrupted.again("--resume", capsys=capsys).code == 0


def test_a_part_of_another_origin_is_not_gone_on_from(
    interrupted: Interrupted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def refusal(**rest: Any) -> str:
        done = interrupted.again("--resume", capsys=capsys, **rest)
        assert done.code == 2
        assert (interrupted.partial / "frames.csv").is_file()
        return str(done.err)

    state = interrupted.partial / "replay.json"
    good = state.read_text()
    # A parameter that the older part knows nothing of.
    values = json.loads(good)
    del values["parameters"]["replay.duration"]
    state.write_text(json.dumps(values))
    assert "was made with another replay.duration" in refusal()
    state.write_text("{")
    assert "cannot go on from" in refusal()
    state.write_text(good)
    other = shutil.copytree(interrupted.bag, tmp_path / "other" / interrupted.bag.name)
    data = bytearray((other / "hard.mcap").read_bytes())
    data[len(data) // 2] ^= 1
    (other / "hard.mcap").write_bytes(data)
    assert "is not of hard as it is now" in refusal(bag=other)
    with monkeypatch.context() as patched:
        patched.setattr(provenance, "__version__", "0.0.1")
        assert "is of another version" in refusal()
    # Another frame, whatever the state says.
    table, log = (interrupted.partial / name for name in ("frames.csv", frame_log.NAME))
    table.write_text(table.read_text().replace(f"\n{DARK},", "\n9,"))
    log.write_text(log.read_text().replace(f'"frame": {DARK},', '"frame": 9,'))
    assert "has other frames" in refusal()
    assert interrupted.again("--force").code == 0
    assert not interrupted.partial.exists()


def test_files_are_told_apart_without_reading_them_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provenance, "SAMPLE", 10)
    path = tmp_path / "dive.mcap"
    content = bytes(20_000)

    def changed(data: bytes) -> bool:
        path.write_bytes(data)
        return provenance.fingerprint([path]) != same

    path.write_bytes(content)
    same = provenance.fingerprint([path])
    assert not changed(content)
    assert changed(content + b"\0")
    for position in (0, 99, len(content) // 2, len(content) - 1):
        # Anywhere at the ends, and in each of the samples in between.
        data = bytearray(content)
        data[position : position + 400] = b"\1" * len(data[position : position + 400])
        assert changed(bytes(data)), position
    path.rename(tmp_path / "other.mcap")
    path = tmp_path / "other.mcap"
    assert changed(content)


def test_a_result_of_several_is_complete_for_its_own_input_alone(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bags = [shutil.copytree(transect, tmp_path / name) for name in ("one", "two")]
    command = ["replay", *map(str, bags), "-o", str(tmp_path / "day"), "--jobs", "1"]
    command += ["--every", "3", "--resume"]
    assert main(command) == 0
    tables = [tmp_path / "day" / bag.name / "frames.csv" for bag in bags]
    before = [table.stat().st_mtime_ns for table in tables]
    told = capsys.readouterr().out
    assert main(command) == 0
    assert [table.stat().st_mtime_ns for table in tables] == before
    # What was told of the choices is told again.
    assert told.count("give --transfer") == capsys.readouterr().out.count("give --transfer") == 2
    for options, difference in ((["--video"], "with other --images, --video"),
                                (["--match-original"], "replay.match_original: give another")):
        assert main([*command, *options]) == 2
        told = capsys.readouterr().err
        assert "one exists already and was made with" in told
        assert difference in told
    # Another recording has come under the same name.
    file = bags[1] / "transect.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    assert main(command) == 2
    assert "two exists already and is not of two as it is now" in capsys.readouterr().err
    assert [table.stat().st_mtime_ns for table in tables] == before
