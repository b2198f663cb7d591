# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Bags are written whole or not at all, and read back or refused with a reason."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from itertools import chain
from pathlib import Path

import pytest

pytest.importorskip("rosbags")

from bag_copies import copy_bag, shortened
from rosbags.rosbag2 import StoragePlugin

from uw_visibility.errors import InputError
from uw_visibility.messages.images import read_image
from uw_visibility.replay.bags.indexed import IndexedFile
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.bags.storage import Part, Recorded
from uw_visibility.replay.bags.writer import BagWriter

TOPICS = {"/a": "std_msgs/msg/Float64", "/b": "std_msgs/msg/String"}


def write(path: Path) -> None:
    with closing(BagWriter(path, TOPICS)) as bag:
        for k in range(3):
            bag.write("/a", bag.make("std_msgs/msg/Float64", data=k / 2), 100 + 10 * k)
        bag.write("/b", bag.make("std_msgs/msg/String", data="tief"), 105)


def test_what_is_written_is_read_back_in_the_order_of_time(tmp_path: Path) -> None:
    write(tmp_path / "bag")
    with BagReader(tmp_path / "bag") as bag:
        assert bag.topics == TOPICS
        messages = [(m.topic, m.type, m.time, bag.deserialize(m).data) for m in bag.messages()]
        assert messages == [
            ("/a", "std_msgs/msg/Float64", 100, 0.0),
            ("/b", "std_msgs/msg/String", 105, "tief"),
            ("/a", "std_msgs/msg/Float64", 110, 0.5),
            ("/a", "std_msgs/msg/Float64", 120, 1.0),
        ]
        assert [m.time for m in bag.messages(["/b"])] == [105]
        assert list(bag.messages(["/nothing"])) == []


def parts(folder: Path, times: dict[str, list[int]]) -> Path:
    """Write a bag of several files without metadata, as after a crash."""
    folder.mkdir()
    for name, stamps in times.items():
        with closing(BagWriter(folder.parent / name, TOPICS)) as bag:
            for time in stamps:
                bag.write("/a", bag.make("std_msgs/msg/Float64", data=0.0), time)
        (folder.parent / name / f"{name}.mcap").rename(folder / f"{name}.mcap")
    return folder


def test_files_without_metadata_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    with BagReader(parts(tmp_path / "bag", {f"dive_{k}": [k] for k in range(12)})) as bag:
        assert [file.stem for file in bag.files] == [f"dive_{k}" for k in range(12)]


@pytest.mark.parametrize("times", [
    {"camera": [1, 3, 5], "sensors": [2, 4, 6]},
    {"a": [10, 11], "b": [1, 2], "c": [5, 6]},
    {"a": [1, 9], "b": [2], "c": [3, 8], "d": [9, 10], "e": []},
], ids=["of two recorders", "named in another order", "within others"])
def test_messages_of_several_files_are_in_the_order_of_time(
    times: dict[str, list[int]], tmp_path: Path
) -> None:
    with BagReader(parts(tmp_path / "bag", times)) as bag:
        expected = sorted(chain(*times.values()))
        assert [m.time for m in bag.messages()] == expected
        assert [m.time for m in bag.messages(start=2, stop=6)] == [
            time for time in expected if 2 <= time < 6]


def test_a_file_is_read_only_from_where_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A day has many files, and each that is being read takes the memory of a chunk."""
    begun = []
    messages = IndexedFile.messages

    def counted(self: IndexedFile, part: Part) -> Iterator[Recorded]:
        begun.append(self.span)
        return messages(self, part)

    monkeypatch.setattr(IndexedFile, "messages", counted)
    with BagReader(parts(tmp_path / "bag", {"a": [1, 4], "b": [3, 6], "c": [7, 8]})) as bag:
        seen = [(m.time, len(begun)) for m in bag.messages()]
    assert seen == [(1, 1), (3, 2), (4, 2), (6, 2), (7, 3), (8, 3)]


@pytest.mark.parametrize("cut", ["a", "b"])
def test_a_split_bag_lasts_from_its_first_file_to_its_last_also_if_one_is_cut(
    cut: str, tmp_path: Path
) -> None:
    folder = parts(tmp_path / "bag", {"a": [1, 2, 3], "b": [4, 5, 6], "c": []})
    shortened(folder / f"{cut}.mcap", 0.9)
    with BagReader(folder) as bag:
        assert bag.span == (1, 6)
        assert [m.time for m in bag.messages(start=2, stop=6)] == [2, 3, 4, 5]


def test_how_long_a_bag_lasts_is_unknown_if_a_file_does_not_say(
    transect: Path, tmp_path: Path
) -> None:
    folder = parts(tmp_path / "bag", {"b": [4, 5, 6]})
    copied = copy_bag(transect, tmp_path / "a", storage=StoragePlugin.SQLITE3)
    shortened(copied / "a.db3", 0.7).rename(folder / "a.db3")
    with BagReader(folder) as bag:
        assert bag.span is None


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read bag .*missing"):
        BagReader(tmp_path / "missing")
    with pytest.raises(InputError, match="cannot read bag"):
        BagReader(tmp_path)
    write(tmp_path / "bag")
    storage = tmp_path / "bag" / "bag.mcap"
    storage.write_bytes(storage.read_bytes()[:50])
    with pytest.raises(InputError, match="cannot read bag"):
        BagReader(tmp_path / "bag")


def test_arrays_can_be_written_to(transect: Path) -> None:
    """Kernels would be compiled a second time, for seconds, for arrays that cannot."""
    with BagReader(transect) as bag:
        message = bag.deserialize(next(bag.messages(["/left/image_rect"])))
    assert read_image(message).flags.writeable
