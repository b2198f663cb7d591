# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""No one bit costs an MCAP recording; others are read, or refused with what mends them."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("rosbags")

# Cases are shared with fuzz.py; pytest's import mode leaves this folder out.
sys.path.insert(0, str(Path(__file__).parent))

from rosbags.rosbag2 import StoragePlugin
from small_bags import write_ros1, write_ros2

from uw_visibility.errors import InputError
from uw_visibility.replay.bags.reader import BagReader, UnreadableError

PLACES = 120


def usable(path: Path) -> int:
    """Return how many messages of a bag can be used."""
    count = 0
    with BagReader(path) as reader:
        for message in reader.messages():
            try:
                reader.deserialize(message)
            except InputError:
                continue
            count += message.topic in reader.channels
    return count


@pytest.mark.parametrize("form", ["mcap", "sqlite", "ROS 1"])
def test_any_one_bit_costs_little_or_is_told(form: str, tmp_path: Path) -> None:
    if form == "ROS 1":
        source = file = write_ros1(tmp_path / "bag.bag")
    else:
        file = write_ros2(
            tmp_path / "bag", StoragePlugin.SQLITE3 if form == "sqlite" else StoragePlugin.MCAP
        )
        source = file.parent
    whole = file.read_bytes()
    total = usable(source)
    # Both ends, where the structure is dense, and what lies between.
    ends = len(whole) // 40
    places = [
        *range(0, ends, ends // PLACES), *range(ends, len(whole) - ends, len(whole) // PLACES),
        *range(len(whole) - ends, len(whole), ends // PLACES),
    ]
    lost, refused = {}, []
    for number, place in enumerate(places):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << (number % 8)
        file.write_bytes(damaged)
        try:
            lost[place] = total - usable(source)
        except UnreadableError as error:
            refused.append(str(error))
    if form == "mcap":
        assert refused == []
        # One record names a topic.
        assert max(lost.values()) < total, lost
        assert sum(count > 4 for count in lost.values()) <= len(lost) // 100, lost
    # Of the others some are refused: the command that mends them is named, or what is wrong.
    assert len(refused) <= len(places) // 10, refused
    told = ("rosbag reindex", ".recover", "is not a recording: ")
    assert all(any(words in said for words in told) for said in refused), refused
