# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged recordings: everything readable is processed, and what is not is said."""

from __future__ import annotations

import re
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from bag_copies import FRAMES, Message, copy_bag, copy_bag_ros1, run, shortened
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from uw_visibility.errors import InputError
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.columns import FAILED

ZSTANDARD = b"\x28\xb5\x2f\xfd"


def again(messages: Iterator[Message]) -> Iterator[Message]:
    """Play a recording four times over, so that it takes several chunks."""
    once = list(messages)
    for k in range(4):
        for topic, kind, message, time in once:
            message.header.stamp.sec += 10 * (k > 0)
            yield topic, kind, message, time + k * 10_000_000_000


def frames(rows: list[dict[str, str]]) -> int:
    return sum(row["status"] != FAILED for row in rows)


@pytest.mark.parametrize("form", ["mcap", "mcap, packed chunks", "sqlite"])
def test_a_truncated_recording_is_read_up_to_its_end(
    form: str, transect: Path, replayed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    storage = StoragePlugin.SQLITE3 if form == "sqlite" else StoragePlugin.MCAP
    mode = CompressionMode.STORAGE if "packed" in form else CompressionMode.NONE
    bag = copy_bag(transect, tmp_path / "bag", edit=again, storage=storage, mode=mode)
    shortened(next(f for f in bag.iterdir() if f.suffix != ".yaml"), 0.7)
    done = run(bag, tmp_path / "out", capsys=capsys)
    assert done.code == 0
    assert FRAMES <= frames(done.rows) == len(done.rows) < 4 * FRAMES
    with (replayed / "frames.csv").open() as whole, (tmp_path / "out" / "frames.csv").open() as cut:
        # The last row may lack the sensor's value that came after it.
        assert cut.readlines()[:FRAMES] == whole.readlines()[:FRAMES]
    assert "damaged" in done.err
    # Of a cut file Python says that it cannot fit 'int' into something.
    assert "'int'" not in done.err
    # What the bag should hold is known from beside it.
    lost = int(re.search(r"(\d+) of \d+ messages on /left/image_rect are", done.err)[1])
    assert 4 * FRAMES - lost - len(done.rows) in (0, 1)
    assert (".recover | sqlite3" in done.err) == (form == "sqlite")
    assert "damaged" in (tmp_path / "out" / "report.html").read_text()


def test_a_truncated_bag_of_ros1_is_refused_with_what_mends_it(
    transect: Path, tmp_path: Path
) -> None:
    bag = shortened(copy_bag_ros1(transect, tmp_path / "bag.bag"), 0.7)
    with pytest.raises(InputError, match=r"is damaged .* run rosbag reindex bag\.bag"):
        BagReader(bag)


def test_a_database_without_its_head_is_refused_with_what_mends_it(
    transect: Path, tmp_path: Path
) -> None:
    bag = copy_bag(transect, tmp_path / "bag", storage=StoragePlugin.SQLITE3)
    (file,) = bag.glob("*.db3")
    file.write_bytes(bytes(100) + file.read_bytes()[100:])
    with pytest.raises(InputError, match=r"run sqlite3 bag\.db3 \.recover \| sqlite3 mended\.db3"):
        BagReader(bag)


@pytest.fixture
def crashed(transect: Path, tmp_path: Path) -> Path:
    """A database whose last message is only in its write-ahead log, as after a crash."""
    bag = copy_bag(transect, tmp_path / "whole", storage=StoragePlugin.SQLITE3)
    (tmp_path / "bag").mkdir()
    with closing(sqlite3.connect(bag / "whole.db3", isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("PRAGMA wal_autocheckpoint=0")
        database.execute("INSERT INTO messages SELECT 10000, topic_id, timestamp + 1000, data "
                         "FROM messages ORDER BY id DESC LIMIT 1")
        for end in ("", "-wal"):
            shutil.copy(bag / f"whole.db3{end}", tmp_path / "bag" / f"bag.db3{end}")
    return tmp_path / "bag" / "bag.db3"


def test_a_log_beside_a_database_is_told_with_what_merges_them(crashed: Path) -> None:
    with BagReader(crashed) as reader:
        read = len(list(reader.messages()))
        (note,) = reader.damage
    assert "bag.db3 is incomplete without bag.db3-wal" in note
    assert "run sqlite3 bag.db3 .tables" in note
    # What its shell does: the last one to close a database merges them.
    with closing(sqlite3.connect(crashed)) as database:
        database.execute("SELECT name FROM sqlite_master").fetchall()
    with BagReader(crashed) as reader:
        assert len(list(reader.messages())) == read + 1
        assert reader.damage == []


def test_a_database_that_is_all_in_its_log_is_not_damaged(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    bag = tmp_path / "bag" / "bag.db3"
    with closing(sqlite3.connect(tmp_path / "whole.db3", isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("CREATE TABLE topics (id, name, type)")
        for end in ("", "-wal"):
            shutil.copy(tmp_path / f"whole.db3{end}", f"{bag}{end}")
    with pytest.raises(InputError, match=r"bag\.db3 is incomplete without bag\.db3-wal") as refused:
        BagReader(bag)
    assert "damaged" not in str(refused.value)


def test_a_damaged_chunk_of_ros1_ends_the_messages_and_is_told(
    transect: Path, tmp_path: Path
) -> None:
    bag = copy_bag_ros1(
        copy_bag(transect, tmp_path / "long", edit=again), tmp_path / "bag.bag", "BZ2")
    content = bag.read_bytes()
    middle = content.index(b"BZh", len(content) // 2)
    bag.write_bytes(content[:middle] + bytes(100) + content[middle + 100:])
    with BagReader(bag) as reader:
        read = len(list(reader.messages(["/left/image_rect"])))
        (note,) = reader.damage
    assert 0 < read < 4 * FRAMES
    assert "rosbag reindex" in note and "read up to the damage" in note


def test_a_damaged_chunk_in_the_middle_costs_what_it_holds(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = copy_bag(transect, tmp_path / "bag", edit=again, mode=CompressionMode.STORAGE)
    file = bag / "bag.mcap"
    data = file.read_bytes()
    second = data.index(ZSTANDARD, data.index(ZSTANDARD) + 4)
    assert ZSTANDARD in data[second + 4 :]
    file.write_bytes(data[:second] + bytes(4) + data[second + 4 :])
    done = run(bag, tmp_path / "out", capsys=capsys)
    assert done.code == 0
    assert FRAMES < frames(done.rows) < 4 * FRAMES
    assert done.rows[-1]["stamp"] == "1700000032.500000000"
    assert "could not be unpacked" in done.err
    assert "are missing" in done.err


def test_missing_messages_are_counted(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def without(messages: Iterator[Message]) -> Iterator[Message]:
        seen = 0
        for message in messages:
            seen += message[0] == "/right/image_rect"
            if message[0] != "/right/image_rect" or seen not in (2, 4):
                yield message

    bag = copy_bag(transect, tmp_path / "bag", edit=without)
    with BagReader(bag) as reader:
        lost = FRAMES - len(list(reader.messages(["/right/image_rect"])))
    assert lost == 2
    done = run(bag, tmp_path / "out", capsys=capsys)
    assert (done.code, frames(done.rows)) == (0, FRAMES - 2)
    assert "dropped: left image unmatched (2)" in done.out
    assert "left image unmatched" in (tmp_path / "out" / "report.html").read_text()


def test_messages_whose_topic_is_lost_are_counted(transect: Path, tmp_path: Path) -> None:
    bag = copy_bag(transect, tmp_path / "bag", storage=StoragePlugin.SQLITE3)
    (file,) = bag.glob("*.db3")
    database = sqlite3.connect(file)
    with database:
        database.execute("DELETE FROM topics WHERE name = '/right/image_rect'")
    database.close()
    with BagReader(bag) as reader:
        assert "/right/image_rect" not in reader.channels
        notes = "; ".join(reader.damage)
    assert f"{FRAMES} messages are of topics that it does not name" in notes
    assert f"{FRAMES} messages on /right/image_rect are missing" in notes


def test_messages_whose_topic_an_index_has_lost_are_read(transect: Path, tmp_path: Path) -> None:
    bag = copy_bag(transect, tmp_path / "bag", mode=CompressionMode.STORAGE)
    (file,) = bag.glob("*.mcap")
    content = bytearray(file.read_bytes())
    # Of its channel in the index, which no checksum covers here: op, length, two ids, length.
    channel = content.rindex(b"/right/image_rect") - 17
    assert content[channel] == 4
    content[channel] = 0xF7
    file.write_bytes(content)
    with BagReader(bag) as reader:
        read = [message.topic for message in reader.messages()]
        (note,) = reader.damage
    assert read.count("/right/image_rect") == FRAMES
    assert "its index counts messages of topics that it does not name" in note


def test_a_camera_that_dies_ends_the_frames_but_not_the_replay(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def dying(messages: Iterator[Message]) -> Iterator[Message]:
        seen = 0
        for message in messages:
            seen += message[0] == "/right/image_rect"
            if seen <= 2 or not message[0].startswith("/right"):
                yield message

    done = run(copy_bag(transect, tmp_path / "bag", edit=dying), tmp_path / "out", capsys=capsys)
    assert (done.code, frames(done.rows)) == (0, 2)
    assert f"dropped: left image unmatched ({FRAMES - 2})" in done.out
    assert "left image unmatched" in (tmp_path / "out" / "report.html").read_text()


def test_stamps_that_go_back_are_said(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A vehicle's clock is set back by a minute between the third and the fourth frame."""
    def back(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in messages:
            if time >= 1_700_000_001_500_000_000:
                message.header.stamp.sec -= 60
            yield topic, kind, message, time

    done = run(copy_bag(transect, tmp_path / "bag", edit=back), tmp_path / "out", capsys=capsys)
    assert (done.code, frames(done.rows)) == (0, FRAMES)
    assert "stamps of the images jumped back once" in done.err
    assert "camera_info changed" not in done.err


def test_a_calibration_that_changes_is_said(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A driver is started again with the calibration of another mode."""
    def large(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in messages:
            if topic.endswith("camera_info"):
                message.p = message.p * np.array([2, 1, 2, 2, 1, 2, 2, 1, 1, 1, 1, 1])
            yield topic, kind, message, time

    def other(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in messages:
            if topic.endswith("camera_info") and time >= 1_700_000_001_500_000_000:
                message.p = message.p * np.array([2, 1, 1, 2, 1, 2, 1, 1, 1, 1, 1, 1])
            yield topic, kind, message, time

    done = run(copy_bag(transect, tmp_path / "bag", edit=other), tmp_path / "out", capsys=capsys)
    assert (done.code, frames(done.rows)) == (0, FRAMES)
    assert "camera_info changed once, first at frame 3: ranges before or after" in done.err
    assert "far from the middle" not in done.err
    done = run(copy_bag(transect, tmp_path / "other", edit=large), tmp_path / "all", capsys=capsys)
    for side in ("left", "right"):
        assert f"{side} camera_info has the principal point 159 119, far from" in done.err


def test_an_unknown_type_among_the_topics_does_no_harm(
    transect: Path, replayed: Path, tmp_path: Path
) -> None:
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg("float64 salinity\n", "sonde/msg/Sample"))
    bag = tmp_path / "bag"
    from rosbags.rosbag2 import Writer

    with BagReader(transect) as reader, Writer(
        bag, version=9, storage_plugin=StoragePlugin.MCAP
    ) as writer:
        strange = writer.add_connection("/sonde", "sonde/msg/Sample", typestore=types)
        sample = types.types["sonde/msg/Sample"](35.0)
        connections = {}
        for m in reader.messages():
            if m.topic not in connections:
                connections[m.topic] = writer.add_connection(m.topic, m.type, typestore=types)
            writer.write(connections[m.topic], m.time, m.data)
            writer.write(strange, m.time, types.serialize_cdr(sample, "sonde/msg/Sample"))
    file = bag / "bag.mcap"
    # Its definition is not even one: a letter that no definition begins with.
    file.write_bytes(file.read_bytes().replace(b"float64 salinity", b"\xc3\x9foat64 salinit!"))
    assert run(bag, tmp_path / "out").code == 0
    expected = (replayed / "frames.csv").read_bytes()
    assert (tmp_path / "out" / "frames.csv").read_bytes() == expected


def test_a_damaged_message_costs_its_frame(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def short(messages: Iterator[Message]) -> Iterator[Message]:
        for index, (topic, kind, message, time) in enumerate(messages):
            if index == 5:
                assert kind == "sensor_msgs/msg/Image"
                message.data = message.data[:100]
            yield topic, kind, message, time

    done = run(copy_bag(transect, tmp_path / "bag", edit=short), tmp_path / "out", capsys=capsys)
    assert (done.code, frames(done.rows), len(done.rows)) == (0, FRAMES - 1, FRAMES)
    assert "unusable frame: left image has 100 bytes of data" in done.out


def test_without_metadata_the_files_are_read(copied: Path, tmp_path: Path) -> None:
    (copied / "metadata.yaml").unlink()
    (copied / "transect.mcap").rename(copied / "bag_0.mcap")
    done = run(copied, tmp_path / "out")
    assert (done.code, frames(done.rows)) == (0, FRAMES)


@pytest.mark.parametrize(("name", "content", "why"), [
    ("a.mcap", b"", "it is empty"), ("a.bag", b"", "it is empty"),
    ("a.mcap", b"\x89MCAP0", "its end is missing"),
])
def test_a_file_that_was_hardly_begun_is_said_to_be_so(
    tmp_path: Path, name: str, content: bytes, why: str
) -> None:
    """As after a full disk: the recorder opens a file, and writes nothing into it."""
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=f"cannot read bag .*{name}: {why}"):
        BagReader(tmp_path / name)


def test_nothing_readable_is_exit_code_1_and_no_bag_is_2(
    copied: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (copied / "transect.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(1000))
    with pytest.raises(SystemExit) as ended:
        run(copied, tmp_path / "out")
    assert ended.value.code == 1
    assert "cannot read bag" in capsys.readouterr().err
    assert run(tmp_path / "nowhere", tmp_path / "out").code == 2
    (tmp_path / "notes.txt").write_text("x")
    assert run(tmp_path / "notes.txt", tmp_path / "out").code == 2
    assert "is not a recording" in capsys.readouterr().err
    assert not list(tmp_path.glob("out*"))
