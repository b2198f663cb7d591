# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Whatever form a recording has, its messages are the same, and so is the table."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from bag_copies import FRAMES, Message, compressed, copy_bag, copy_bag_ros1, run
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from uw_visibility.replay.bags.reader import BagReader

SQLITE = StoragePlugin.SQLITE3


def split(bag: Path, target: Path) -> Path:
    """Make a bag of two files."""
    def half(first: bool) -> Callable[[Iterator[Message]], Iterator[Message]]:
        def edit(messages: Iterator[Message]) -> Iterator[Message]:
            ordered = list(messages)
            middle = ordered[len(ordered) // 2][3]
            yield from (m for m in ordered if (m[3] < middle) == first)
        return edit

    parts = [copy_bag(bag, target.with_name(f"part{k}"), edit=half(k == 0)) for k in range(2)]
    target.mkdir()
    metadata = yaml.safe_load((parts[0] / "metadata.yaml").read_text())
    about = metadata["rosbag2_bagfile_information"]
    about["relative_file_paths"] = []
    for k, part in enumerate(parts):
        shutil.move(part / f"part{k}.mcap", target / f"bag_{k}.mcap")
        about["relative_file_paths"].append(f"bag_{k}.mcap")
    for topic in about["topics_with_message_count"]:
        topic["message_count"] = FRAMES
    (target / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    return target


FORMS: dict[str, Callable[[Path, Path], Path]] = {
    "mcap file": lambda bag, target: bag / f"{bag.name}.mcap",
    "mcap, packed chunks": lambda bag, target: copy_bag(bag, target, mode=CompressionMode.STORAGE),
    "mcap, packed messages": lambda bag, target: copy_bag(
        bag, target, mode=CompressionMode.MESSAGE),
    "mcap, packed file": lambda bag, target: copy_bag(bag, target, mode=CompressionMode.FILE),
    "sqlite": lambda bag, target: copy_bag(bag, target, storage=SQLITE),
    "sqlite file": lambda bag, target: copy_bag(bag, target, storage=SQLITE) / "copy.db3",
    "sqlite, packed messages": lambda bag, target: copy_bag(
        bag, target, storage=SQLITE, mode=CompressionMode.MESSAGE),
    "split": split,
    "ROS 1": lambda bag, target: copy_bag_ros1(bag, target.with_suffix(".bag")),
    "ROS 1, bz2": lambda bag, target: copy_bag_ros1(bag, target.with_suffix(".bag"), "BZ2"),
    "ROS 1, lz4": lambda bag, target: copy_bag_ros1(bag, target.with_suffix(".bag"), "LZ4"),
}


def contents(bag: Path) -> list[tuple[str, int, int, bytes]]:
    found = []
    with BagReader(bag) as reader:
        for m in reader.messages():
            message = reader.deserialize(m)
            data = bytes(message.data) if hasattr(message, "data") else b""
            found.append((m.topic, m.time, message.header.stamp.nanosec, data))
        assert reader.damage == []
        assert reader.span == (found[0][1], found[-1][1])
        assert {c.count for c in reader.channels.values()} == {FRAMES}
    return sorted(found)


@pytest.mark.parametrize("form", FORMS)
def test_every_form_holds_the_same_messages(form: str, transect: Path, tmp_path: Path) -> None:
    assert contents(FORMS[form](transect, tmp_path / "copy")) == contents(transect)


@pytest.mark.parametrize("form", ["sqlite", "ROS 1", "split"])
def test_every_form_has_the_same_table(
    form: str, transect: Path, replayed: Path, tmp_path: Path
) -> None:
    bag = FORMS[form](transect, tmp_path / "copy")
    assert run(bag, tmp_path / "out").code == 0
    expected = (replayed / "frames.csv").read_bytes()
    assert (tmp_path / "out" / "frames.csv").read_bytes() == expected


def test_compressed_images_without_loss_have_the_same_table_and_are_asked_about(
    transect: Path, replayed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = copy_bag(transect, tmp_path / "copy", edit=compressed)
    done = run(bag, tmp_path / "out", capsys=capsys)
    assert done.code == 0
    assert "give --transfer srgb" in done.out
    told = run(bag, tmp_path / "told", "--transfer", "linear", "--every", "9", capsys=capsys)
    assert "give --transfer srgb" not in told.out
    expected = (replayed / "frames.csv").read_bytes()
    assert (tmp_path / "out" / "frames.csv").read_bytes() == expected


def test_a_part_of_the_time_is_read(transect: Path) -> None:
    with BagReader(transect) as reader:
        assert reader.span is not None
        begin = reader.span[0]
        part = list(reader.messages(["/depth_sensor"], begin + 500_000_000, begin + 1_500_000_000))
        assert [(m.time - begin) / 1e9 for m in part] == [0.5, 1.0]
