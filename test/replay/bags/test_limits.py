# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings that claim, or unpack to, more than any recording has."""

from __future__ import annotations

import bz2
import os
import sqlite3
import struct
import tracemalloc
from pathlib import Path

import lz4.frame
import pytest
from bag_copies import FRAMES, copy_bag
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.rosbag2.reader import zstd

from uw_visibility.errors import InputError
from uw_visibility.replay.bags.packing import PackingError, unpack, unpack_part
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.bags.source import MOST_AT_ONCE

MEBIBYTE = 1 << 20
# More than is read, or unpacked, at once.
ZEROS = bytes(MOST_AT_ONCE + MEBIBYTE)
PACK = {"zstd": zstd.compress, "lz4": lz4.frame.compress, "bz2": bz2.compress}


@pytest.fixture(scope="module")
def bombs() -> dict[str, bytes]:
    """Some kilobytes that unpack to more; bzip2 is slow, and serves in one test with less."""
    return {name: pack(ZEROS[: (16 if name == "bz2" else 300) * MEBIBYTE])
            for name, pack in PACK.items()}


@pytest.mark.parametrize("compression", list(PACK))
def test_unpacking_stops_at_the_limit(compression: str, bombs: dict[str, bytes]) -> None:
    bomb = bombs[compression]
    assert len(bomb) < 2 * MEBIBYTE
    tracemalloc.start()
    with pytest.raises(PackingError, match=f"more than {MEBIBYTE} bytes"):
        unpack(bomb, compression, MEBIBYTE)
    assert tracemalloc.get_traced_memory()[1] < 8 * MEBIBYTE
    tracemalloc.stop()


@pytest.mark.parametrize("compression", list(PACK))
def test_what_is_packed_is_unpacked_to_its_last_byte_or_its_damage(compression: str) -> None:
    content = os.urandom(3 * MEBIBYTE)
    packed = PACK[compression](content)
    assert unpack(packed, compression) == content
    assert unpack(packed + packed, compression) == 2 * content
    data, problem = unpack_part(packed[: len(packed) // 2], compression)
    assert problem and content.startswith(data)
    assert unpack_part(b"none of it", compression)[1]


def chunk(compression: str, data: bytes, size: int) -> bytes:
    """Return a chunk of an MCAP file."""
    name = compression.encode()
    content = struct.pack("<QQQII", 0, 1, size, 0, len(name)) + name
    content += struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(content)) + content


@pytest.mark.parametrize(("compression", "claimed"), [
    ("zstd", len(ZEROS)), ("lz4", 1 << 34), ("zstd", 100)])
def test_a_bomb_among_the_chunks_costs_itself(
    compression: str, claimed: int, bombs: dict[str, bytes], copied: Path
) -> None:
    file = copied / "transect.mcap"
    data = file.read_bytes()
    # Before the end of the data, so that only a scan finds it.
    file.write_bytes(data[:-100] + chunk(compression, bombs[compression], claimed))
    tracemalloc.start()
    with BagReader(file) as reader:
        count = sum(1 for _ in reader.messages(["/left/image_rect"]))
        assert any("damaged" in note for note in reader.damage)
    assert count == FRAMES
    # Packed, unpacked, and nothing a third time.
    assert tracemalloc.get_traced_memory()[1] < 600 * MEBIBYTE
    tracemalloc.stop()


def test_a_packed_file_that_would_fill_the_disk_is_given_up(
    tmp_path: Path, bombs: dict[str, bytes]
) -> None:
    file = tmp_path / "bag.mcap.zstd"
    file.write_bytes(20 * bombs["zstd"])
    with pytest.raises(InputError, match="cannot read bag"):
        BagReader(file)


@pytest.mark.parametrize("suffix", [".mcap", ".bag", ".db3"])
def test_a_huge_file_of_nothing_is_refused(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"bag{suffix}"
    with file.open("wb") as stream:
        stream.write({".mcap": b"\x89MCAP0\r\n", ".bag": b"#ROSBAG V2.0\n", ".db3": b""}[suffix])
        stream.truncate(len(ZEROS))
    with pytest.raises(InputError, match="cannot read bag"):
        BagReader(file)


def test_a_pipe_is_no_bag(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "bag.mcap")
    for path in (tmp_path / "bag.mcap", tmp_path):
        with pytest.raises(InputError):
            BagReader(path)


@pytest.fixture
def database(transect: Path, tmp_path: Path) -> sqlite3.Connection:
    """The transect as a database that may be written to."""
    bag = copy_bag(transect, tmp_path / "bag", storage=StoragePlugin.SQLITE3)
    return sqlite3.connect(bag / "bag.db3", isolation_level=None)


ENDLESS = (
    "CREATE VIEW {} AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) "
    "SELECT id, id AS timestamp, 1 AS topic_id, 'a' AS name, 'b' AS type, x'00' AS data FROM n"
)


@pytest.mark.parametrize("statements", [
    ("DROP TABLE messages", ENDLESS.format("messages")),
    ("DROP TABLE topics", ENDLESS.format("topics")),
])
def test_tables_that_run_without_end_are_refused(
    database: sqlite3.Connection, tmp_path: Path, statements: tuple[str, ...]
) -> None:
    for statement in statements:
        database.execute(statement)
    database.close()
    with pytest.raises(InputError, match="no plain table"):
        BagReader(tmp_path / "bag")


def test_columns_that_are_computed_are_not_run(
    database: sqlite3.Connection, tmp_path: Path
) -> None:
    database.execute("DROP TABLE messages")
    database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data AS "
                     "(zeroblob(900000000)))")
    database.execute("INSERT INTO messages(topic_id, timestamp) VALUES (1, 1), (2, 2)")
    database.close()
    with pytest.raises(InputError, match="no plain table"):
        BagReader(tmp_path / "bag")


@pytest.mark.parametrize("value", ["NULL", "'text'", "2000000000", "1.5"])
@pytest.mark.parametrize("column", ["data", "timestamp", "topic_id"])
def test_rows_of_another_type_are_counted_as_lost(
    database: sqlite3.Connection, tmp_path: Path, column: str, value: str
) -> None:
    database.execute("CREATE TABLE other AS SELECT * FROM messages")
    database.execute("DROP TABLE messages")
    database.execute("ALTER TABLE other RENAME TO messages")
    database.execute(
        f"UPDATE messages SET {column} = {value} WHERE id IN (SELECT messages.id FROM messages "
        "JOIN topics ON topics.id = topic_id WHERE name = '/left/image_rect' LIMIT 2)"
    )
    database.close()
    with BagReader(tmp_path / "bag") as reader:
        read = list(reader.messages(["/left/image_rect"]))
        assert all(isinstance(m.data, bytes) and isinstance(m.time, int) for m in read)
        known = (column, value) == ("timestamp", "2000000000")
        assert len(read) == FRAMES - 2 * (not known)
        if column != "topic_id" and not known:
            assert any("2 rows that are not messages" in note for note in reader.damage)
        assert reader.channels["/left/image_rect"].count == FRAMES


def test_a_message_packed_by_itself_needs_no_metadata(transect: Path, tmp_path: Path) -> None:
    bag = copy_bag(transect, tmp_path / "bag", mode=CompressionMode.MESSAGE)
    with BagReader(bag / "bag.mcap") as reader:
        (message, *_) = reader.messages(["/left/image_rect"])
        assert reader.deserialize(message).encoding == "rgb8"
