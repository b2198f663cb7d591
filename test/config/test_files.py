# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Files that are no files, and results that are whole or not there."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from uw_visibility.config.files import (
    Products,
    gathered,
    read_regular,
    refuse_inputs,
    sole_writer,
    write_whole,
)
from uw_visibility.errors import InputError


def test_a_pipe_and_a_device_are_refused_at_once(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero"), tmp_path, tmp_path / "absent", Path("null\0byte"),
                 tmp_path / ("n" * 300)):
        with pytest.raises(InputError, match="table"):
            read_regular(path, 1000, "table")


def test_a_file_beyond_the_limit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(bytes(100))
    assert read_regular(path, 100) == bytes(100)
    with pytest.raises(InputError, match="larger than 99 bytes"):
        read_regular(path, 99)
    # A file of /proc states a size of nothing.
    assert b"python" in read_regular("/proc/self/cmdline", 1 << 20)


def test_what_cannot_be_written_whole_leaves_the_older_file(
    tmp_path: Path, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    path = tmp_path / "result"
    write_whole(path, "older")
    with full_disk(1000), pytest.raises(InputError, match=f"cannot write {path}"):
        write_whole(path, bytes(10_000))
    assert path.read_text() == "older"
    assert [entry.name for entry in tmp_path.iterdir()] == ["result"]


def test_a_link_is_followed_and_a_device_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("target")
    write_whole(tmp_path / "link", "content")
    assert (tmp_path / "target").read_text() == "content"
    assert (tmp_path / "link").is_symlink()
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="no regular file"):
        write_whole(tmp_path / "pipe", "content")


def test_a_second_writer_is_told(tmp_path: Path) -> None:
    target = tmp_path / "new" / "out"
    code = (
        "import sys; from pathlib import Path; from uw_visibility.config.files import sole_writer\n"
        "with sole_writer(Path(sys.argv[1])): pass"
    )
    with sole_writer(target):
        other = subprocess.run(
            [sys.executable, "-c", code, str(target)], capture_output=True, text=True
        )
        assert other.returncode != 0 and f"another run writes {target}" in other.stderr
        with pytest.raises(InputError), sole_writer(target):
            pass
    assert subprocess.run([sys.executable, "-c", code, str(target)]).returncode == 0
    assert not list(target.parent.iterdir())


def test_of_many_writers_one_at_a_time_is_inside(tmp_path: Path) -> None:
    inside = most = done = 0

    def work() -> None:
        nonlocal inside, most, done
        while True:
            try:
                with sole_writer(tmp_path / "out"):
                    inside += 1
                    most = max(most, inside)
                    inside -= 1
                    done += 1
                    return
            except InputError:
                continue

    threads = [threading.Thread(target=work) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (done, most) == (16, 1)


ONE = Products("mark.json", ("table.csv", "images/", "images/*.png"), "nothing", keys=("ours",))


def write(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("ours", encoding="utf-8")


def test_only_what_holds_nothing_else_is_removed(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for foreign in ("notes.txt", "images/notes.txt", "images/sub/a.png", "table.csv.bak"):
        write(out, "mark.json", "table.csv", "images/a.png", foreign)
        with pytest.raises(InputError, match="is not a result of this program"):
            ONE.remove(out)
        (out / foreign).unlink()
    with pytest.raises(InputError, match=r"images/sub is not a result"):
        ONE.remove(out)
    (out / "images" / "sub").rmdir()
    (out / "mark.json").write_text("theirs", encoding="utf-8")
    with pytest.raises(InputError, match="is nothing"):
        ONE.remove(out)
    write(out, "mark.json", ".table.csv.0123456789ab.partial")
    ONE.remove(out)
    assert not out.exists()


def test_earlier_products_go_and_other_files_stay(tmp_path: Path) -> None:
    write(tmp_path, "mark.json", "table.csv", "notes.txt")
    with gathered(tmp_path, ONE, force=True) as folder:
        write(folder, "mark.json")
    assert {path.name for path in tmp_path.iterdir()} == {"mark.json", "notes.txt"}
    with pytest.raises(InputError, match="--force to replace; the results are in"), \
            gathered(tmp_path, ONE, force=False) as folder:
        write(folder, "mark.json", "table.csv")
    (kept,) = tmp_path.glob("*.partial")
    assert (kept / "table.csv").is_file() and not (tmp_path / "table.csv").exists()


def test_products_in_a_linked_folder_are_replaced_and_the_link_stays(tmp_path: Path) -> None:
    write(tmp_path, "out/mark.json", "out/table.csv", "other/table.csv")
    for name, target in (("link", "out"), ("stray", "other")):
        (tmp_path / name).symlink_to(target)
    with gathered(tmp_path / "link", ONE, force=True) as folder:
        write(folder, "mark.json")
    assert (tmp_path / "link").is_symlink()
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mark.json"]
    # Without the mark nothing is replaced, and a folder is never removed by a link.
    with pytest.raises(InputError, match="is nothing"):
        ONE.check_room(tmp_path / "stray", force=True)
    with pytest.raises(InputError, match="is nothing"):
        ONE.remove(tmp_path / "link")
    assert (tmp_path / "out" / "mark.json").is_file()


def test_inputs_are_found_wherever_they_lie(tmp_path: Path) -> None:
    write(tmp_path, "out/deep/in.mcap")
    (tmp_path / "link").symlink_to(tmp_path / "out")
    out, file = tmp_path / "out", tmp_path / "out" / "deep" / "in.mcap"
    for given, place in (
        (file, out), (tmp_path / "link" / "deep", out), (file, tmp_path / "link"), (out, out),
        (f"file://{file}", out), ("s3://b/out/in.mcap", "s3://b/out"),
    ):
        with pytest.raises(InputError, match="would replace the input"):
            refuse_inputs([None, given], [place])
    refuse_inputs([file, "s3://b/out.mcap"], [tmp_path / "out" / "de", "s3://b/out"])
