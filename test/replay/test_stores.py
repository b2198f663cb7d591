# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings and results in object stores: what comes of them is what comes of folders."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from uw_visibility.cli import main
from uw_visibility.errors import InputError
from uw_visibility.replay import stores
from uw_visibility.replay.batch import replay_bags
from uw_visibility.replay.inputs.options import ReplayOptions

fsspec = pytest.importorskip("fsspec", reason="the extra stores is not installed")


@pytest.fixture()
def store(transect: Path, dive: Path) -> Iterator[Any]:
    """A store that has nothing but two recordings."""
    memory = fsspec.filesystem("memory")
    for bag in (transect, dive):
        memory.put(str(bag) + "/", f"/bucket/dives/{bag.name}/", recursive=True)
    yield memory
    memory.rm("/bucket", recursive=True)


@pytest.fixture(scope="module")
def local(transect: Path, dive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What comes of the same recordings in folders."""
    out = tmp_path_factory.mktemp("local") / "day"
    assert main(["replay", str(dive), str(transect), "-o", str(out), *ALONE]) == 0
    return out


# Without processes to start, which would take longer than all else of what is refused.
ALONE = ["--jobs", "1", "--every", "3"]
DAY = ["replay", "memory://bucket/dives/*", "-o", "memory://bucket/day", *ALONE]


def test_a_day_goes_from_store_to_store(store: Any, local: Path) -> None:
    assert main(DAY) == 0
    for name in ("frames.csv", "transect/frames.csv", "dive/frames.csv"):
        assert store.cat(f"/bucket/day/{name}") == (local / name).read_bytes()
    names = {
        str(Path(name).relative_to("/bucket/day")) for name in store.find("/bucket/day")}
    there = {str(path.relative_to(local)) for path in local.rglob("*") if path.is_file()}
    assert names == there
    assert b'href="transect/report.html#' in store.cat("/bucket/day/index.html")
    # Named as the user names them, not by the folder that they are fetched to.
    assert b'"memory://bucket/dives/dive"' in store.cat("/bucket/day/transects.json")
    assert b"<code>memory://bucket/dives/dive</code>" in store.cat("/bucket/day/dive/report.html")


def test_what_is_there_is_neither_replaced_nor_made_again(
    store: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(DAY) == 0
    before = store.modified("/bucket/day/dive/replay.json")
    assert main(DAY) == 2
    assert "day has the results of several recordings already: give another" in (
        capsys.readouterr().err)
    # What was not finished is made; what was is not even fetched.
    store.rm("/bucket/day/transect", recursive=True)
    store.rm("/bucket/dives/dive/metadata.yaml")
    assert main([*DAY, "--resume"]) == 0
    assert store.exists("/bucket/day/transect/replay.json")
    assert store.modified("/bucket/day/dive/replay.json") == before
    assert main([*DAY, "--resume", "--every", "2"]) == 2
    assert "was made with another replay.every" in capsys.readouterr().err
    assert main([*DAY, "--force", "--every", "2"]) == 0
    assert store.modified("/bucket/day/dive/replay.json") > before


def test_one_recording_may_come_from_a_store_and_its_result_stay_here(
    store: Any, local: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = f"memory://bucket/dives/transect/{Path(store.find('/bucket/dives/transect')[1]).name}"
    assert main(["replay", file, "-o", str(tmp_path / "out"), *ALONE]) == 0
    assert (tmp_path / "out" / "frames.csv").read_bytes() == (
        local / "transect" / "frames.csv").read_bytes()
    assert main(["replay", "memory://bucket/dives/dive", "--list"]) == 0
    listed = capsys.readouterr().out
    assert "/left/image_rect" in listed
    assert "memory://bucket/dives/dive: ROS 2, " in listed
    assert "transfer linear (assumed; " in listed


def test_a_calibration_reads_from_a_store(
    store: Any, dive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ended, told = [], []
    for bag in (str(dive), "memory://bucket/dives/d*"):
        ended.append(main(["calibrate", bag, "--jobs", "1"]))
        told.append(capsys.readouterr())
    assert ended[0] == ended[1]
    assert told[0] == told[1]
    assert dive.name in told[1].out + told[1].err


def test_what_others_have_there_is_left_alone(
    store: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    store.pipe("/bucket/day/dive/notes.txt", b"mine")
    assert main([*DAY, "--force"]) == 2
    assert "/dive exists already and is no replay" in capsys.readouterr().err
    assert store.cat("/bucket/day/dive/notes.txt") == b"mine"


@pytest.mark.parametrize(("url", "said"), [
    ("memory://bucket/nothing", "memory://bucket/nothing: it is missing"),
    ("memory://bucket/no*", "nothing matches memory://bucket/no*"),
    ("nostore://bucket/dive", "nostore is not a supported store: give one of s3, "),
    ("zip://dive::memory://bucket/dive.zip", "zip is not a supported store"),
    ("memory://dive::https://here/dive.zip", "memory is not a supported store"),
])
def test_what_is_not_there_is_one_sentence(
    url: str, said: str, store: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", url, "-o", str(tmp_path / "out"), *ALONE]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1


def test_a_result_is_complete_or_has_no_mark(store: Any, tmp_path: Path) -> None:
    """Its state is stored last: what a connection lost is made again, and not taken for all."""
    order: list[str] = []
    put = store.put_file

    class Broken(Exception):
        pass

    def lose(file: str, name: str, **options: Any) -> None:
        order.append(Path(name).name)
        if len(order) == 3:
            raise Broken("connection lost")
        put(file, name, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(store), "put_file", staticmethod(lose))
        with pytest.raises(stores.InputError, match=r"cannot write .*: connection lost"), \
                stores.result_here("memory://bucket/one") as folder:
            folder.mkdir()
            for name in ("a", "replay.json", "z", "zz"):
                (folder / name).write_text(name)
    assert order == ["a", "z", "zz"]
    assert not store.exists("/bucket/one/replay.json")


@pytest.mark.parametrize("url", [
    "s3://user:hidden@bucket/dive", "https://user:hidden@host/dive", "https://hidden@host/dive",
    "https://host/dive?token=hidden", "s3://bucket/*?X-Amz-Signature=hidden",
    "s3://user:hid/den@bucket/dive", "https://host/dive?hidden", "nothing:hidden@host/x://y",
    "sftp://user:hidden@host:22/dive", "https://host/dive#key=hidden",
])
def test_credentials_in_a_url_are_refused_and_shown_nowhere(
    url: str, transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "day"
    for arguments in ([url, str(transect), "-o", str(out)], [str(transect), "-o", url],
                      [url, "--list"]):
        assert main(["replay", *arguments]) == 2
        told = capsys.readouterr().err
        assert not re.search("hid/?den", told)
        assert told.count("\n") == 1
    assert not out.exists()
    # Who calls the library has the same.
    for targets in ({url: out}, {transect: url}):
        with pytest.raises(InputError) as refused:
            replay_bags(targets, ReplayOptions())
        assert not re.search("hid/?den", str(refused.value))


@pytest.mark.parametrize("url", [
    "abfs://container@account.dfs.core.windows.net/dive", "ssh://user@host:22/dive",
    "https://host:8000/dive.mcap", "s3://bucket/2026-06-0?/dive*",
])
def test_names_of_users_and_containers_are_no_credentials(url: str) -> None:
    assert stores.place(url) == url


@pytest.mark.parametrize("told", [True, False])
def test_no_more_is_fetched_than_there_may_be(
    told: bool, store: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stores, "LARGEST", 10_000)
    if not told:
        # A server need not say how much it will send.
        monkeypatch.setattr(type(store), "size", lambda *_: None)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert main(["replay", "memory://bucket/dives/dive", "-o", str(tmp_path / "out"), *ALONE]) == 2
    assert "have more than 1e-05 GB" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_without_fsspec_it_is_said_how_to_get_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "fsspec.core", None)
    assert main(["replay", "s3://bucket/dive", "-o", str(tmp_path / "out"), *ALONE]) == 2
    assert "s3://bucket/dive needs fsspec: install the extra stores, pip install" in (
        capsys.readouterr().err)


def test_a_store_does_not_choose_where_files_go(
    store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    store.pipe("/bucket/dives/dive/../../planted", b"from outside")
    store.pipe("/bucket/dives/dive/..", b"from outside")
    assert main(["replay", "memory://bucket/dives/dive", "-o", str(tmp_path / "out"), *ALONE]) == 2
    assert "an object outside its folder" in capsys.readouterr().err
    assert not list(scratch.rglob("planted"))


def test_a_store_loses_nothing_but_results(
    store: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = ["replay", "memory://bucket/dives/transect", "-o", "memory://bucket/one", *ALONE]
    assert main(one) == 0
    for name in ("one/notes.txt", "one/deep/in.mcap"):
        store.pipe(f"/bucket/{name}", b"mine")
        assert main([*one, "--force"]) == 2
        assert f"memory://bucket/{name} is not a result" in capsys.readouterr().err
        within = ["replay", f"memory://bucket/{name}", *one[2:], "--force"]
        assert main(within) == 2
        assert "would replace the input memory://bucket/one" in capsys.readouterr().err
        assert store.cat(f"/bucket/{name}") == b"mine"
        store.rm(f"/bucket/{name}")
    assert main([*one, "--force"]) == 0
    # Something comes there while it works.
    replay_bag = stores.recording_here

    def plant(bag: Any) -> Any:
        store.pipe("/bucket/two/notes.txt", b"mine")
        return replay_bag(bag)

    monkeypatch.setattr(stores, "recording_here", plant)
    capsys.readouterr()
    assert main([*one[:3], "memory://bucket/two", *ALONE]) == 2
    assert "the result is in memory://bucket/two." in capsys.readouterr().err
    assert store.find("/bucket/two") == ["/bucket/two/notes.txt"]
    (kept,) = store.glob("/bucket/two.*.partial/replay.json")
    assert b'"complete": true' in store.cat(kept)
