# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A new bag appears whole or not at all, and replaces only bags of this program."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rosbags")

from uw_visibility.errors import InputError
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility_lab.simulation.new_bag import new_bag

TOPICS = {"/a": "std_msgs/msg/Float64"}


def write(path: Path, *values: float, overwrite: bool = False) -> None:
    with new_bag(path, TOPICS, overwrite=overwrite) as bag:
        for time, value in enumerate(values):
            bag.write("/a", bag.make("std_msgs/msg/Float64", data=value), time)


def count(path: Path) -> int:
    with BagReader(path) as bag:
        return len(list(bag.messages()))


def test_an_interrupted_bag_is_removed(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), new_bag(tmp_path / "bag", TOPICS) as bag:
        bag.write("/a", bag.make("std_msgs/msg/Float64", data=1.0), 1)
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_an_existing_bag_is_kept_unless_told(tmp_path: Path) -> None:
    write(tmp_path / "bag", 1.0, 2.0)
    with pytest.raises(InputError, match="exists already"):
        write(tmp_path / "bag")
    assert count(tmp_path / "bag") == 2
    write(tmp_path / "bag", overwrite=True)
    assert count(tmp_path / "bag") == 0


def test_only_a_bag_is_overwritten(tmp_path: Path) -> None:
    write(tmp_path / "bag", 1.0)
    (tmp_path / "link").symlink_to(tmp_path / "bag")
    (tmp_path / "file").write_text("x", encoding="utf-8")
    for name in ("link", "file", "."):
        with pytest.raises(InputError, match="not a bag"):
            write(tmp_path / name, overwrite=True)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x", encoding="utf-8")
    with pytest.raises(InputError, match=r"cannot write to folder .*file"):
        write(tmp_path / "file" / "bag")


def test_a_bag_gives_way_to_what_came_under_its_name(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with pytest.raises(InputError, match=r"the bag is in .*bag\.\w*\.partial"), \
            new_bag(path, TOPICS):
        path.mkdir()
        (path / "notes.txt").write_text("mine")
    assert (path / "notes.txt").read_text() == "mine"
    (kept,) = tmp_path.glob("bag.*.partial")
    assert {file.name for file in kept.iterdir()} == {"bag.mcap", "metadata.yaml"}
