# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Salvage of MCAP files, byte by byte: what is whole is read, and nothing else is."""

from __future__ import annotations

import struct
import zlib
from itertools import accumulate
from pathlib import Path

import lz4.frame
import pytest
from rosbags.rosbag2.reader import zstd

from uw_visibility.replay.bags import salvage_mcap
from uw_visibility.replay.bags.salvage_mcap import (
    CHANNEL,
    CHUNK,
    DATA_END,
    DIFFER,
    HEAD,
    LOST,
    MAGIC,
    MESSAGE,
    MESSAGE_FIELDS,
    SCHEMA,
    SKIPPED,
    McapSalvage,
)
from uw_visibility.replay.bags.storage import Part

TOPIC = "/depth"
PACK = {"": bytes, "zstd": zstd.compress, "lz4": lz4.frame.compress}
ATTACHMENT, FOOTER = 9, 2
START = 1_700_000_000_123_456_789
# A damaged highest byte of a length.
ABSURD = 1 << 60
# No byte of it begins a record with a plausible length.
DATA = b"\xff" * 40


def record(kind: int, content: bytes, more: int = 0) -> bytes:
    """Return a record that claims `more` bytes than its content has."""
    return struct.pack("<BQ", kind, len(content) + more) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def message(number: int, data: bytes = DATA, more: int = 0, channel: int = 1) -> bytes:
    return record(MESSAGE, struct.pack("<HIQQ", channel, 0, number, number) + data, more)


def chunk(
    records: bytes, compression: str = "", more: int = 0, size: int | None = None,
    checksum: int | None = None,
) -> bytes:
    packed = PACK[compression](records)
    size = len(records) if size is None else size
    checksum = zlib.crc32(records) if checksum is None else checksum
    fields = struct.pack("<QQQI", START, START + 1, size, checksum) + text(compression)
    return record(CHUNK, fields + struct.pack("<Q", len(packed)) + packed, more)


TOPICS = record(SCHEMA, struct.pack("<H", 1) + text("std_msgs/msg/Float64") + text("ros2msg")
                + text("float64 data\n")) + record(
    CHANNEL, struct.pack("<HH", 1, 1) + text(TOPIC) + text("cdr") + struct.pack("<I", 0))
END = record(DATA_END, bytes(4)) + TOPICS + record(FOOTER, bytes(20)) + MAGIC
BEGIN = MAGIC + TOPICS


def salvaged(file: Path, content: bytes) -> tuple[list[tuple[int, bytes]], list[str]]:
    """Return the messages that a file of this content gives, and what is told of its damage."""
    file.write_bytes(content)
    storage = McapSalvage(file)
    found = [(m.time, m.data) for m in storage.messages(Part()) if m.topic == TOPIC]
    assert all(note.startswith(f"{file.name}: ") for note in storage.damage)
    return found, [note.removeprefix(f"{file.name}: ") for note in storage.damage]


def times(file: Path, *parts: bytes) -> tuple[list[int], list[str]]:
    found, notes = salvaged(file, b"".join(parts))
    assert all(data == DATA for _, data in found)
    return [time for time, _ in found], notes


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "dive.mcap"


def test_a_file_gives_its_messages_wherever_it_is_cut(file: Path) -> None:
    """One that is cut at the end of a message gives that one, and no message is cut short."""
    # Also such as hold nothing, and records of an application.
    parts = [message(0), message(1, b""), record(0x80, b""), message(2), record(0x80, DATA),
             message(3), message(4, b"\xff")]
    ends = list(accumulate(map(len, parts), initial=len(BEGIN)))[1:]
    whole, _ = salvaged(file, BEGIN + b"".join(parts) + END)
    assert whole == [(0, DATA), (1, b""), (2, DATA), (3, DATA), (4, b"\xff")]
    content = BEGIN + b"".join(parts)
    until = [end for end, part in zip(ends, parts, strict=True) if part[0] == MESSAGE]
    for cut in range(len(BEGIN), len(content) + 1):
        found, notes = salvaged(file, content[:cut])
        assert (cut, found) == (cut, whole[:sum(end <= cut for end in until)])
        assert not notes


def test_the_times_of_what_is_read_are_known(file: Path) -> None:
    """Also if the topic is named at the end only, and without a message that has no time."""
    file.write_bytes(MAGIC + chunk(message(5) + message(1 << 63)) + message(3) + END)
    assert McapSalvage(file).span == (3, 5)
    file.write_bytes(BEGIN + END)
    assert McapSalvage(file).span is None


def test_a_last_chunk_gives_its_messages_wherever_it_is_cut(file: Path) -> None:
    parts = [message(k) for k in range(4)]
    before, last = chunk(message(10)), chunk(b"".join(parts))
    begin = BEGIN + before
    ends = list(accumulate(map(len, parts), initial=len(begin + last) - len(b"".join(parts))))[1:]
    for cut in range(len(begin), len(begin + last) + 1):
        found, notes = times(file, (begin + last)[:cut])
        assert (cut, found) == (cut, [10, *range(sum(end <= cut for end in ends))])
        # A chunk without all of its fields is one of the damaged records.
        fields = cut - len(begin) >= HEAD + 40
        whole = cut in (len(begin + last), *range(len(begin), len(begin) + HEAD))
        assert notes == ([] if whole else [f"{LOST if fields else SKIPPED} (1)"])


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_packed_chunk_is_unpacked_as_far_as_it_goes(compression: str, file: Path) -> None:
    begin, last = BEGIN + chunk(message(10)), chunk(
        b"".join(message(k) for k in range(4)), compression)
    for cut in range(len(begin), len(begin + last)):
        found, _ = times(file, (begin + last)[:cut])
        assert (cut, found) == (cut, [10, 0, 1, 2, 3][:len(found)])
    assert times(file, begin, last) == ([10, 0, 1, 2, 3], [])


@pytest.mark.parametrize("compression", list(PACK))
@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("more", [1, 1 << 20, ABSURD])
def test_a_chunk_that_claims_too_much_is_read_by_its_fields(
    more: int, last: bool, compression: str, file: Path
) -> None:
    """Its messages and those of the next one are whole."""
    damaged = chunk(message(0) + message(1), compression, more=more)
    other = chunk(message(2), compression)
    parts = (other, damaged) if last else (damaged, other)
    assert times(file, BEGIN, *parts) == ([2, 0, 1] if last else [0, 1, 2], [])
    assert times(file, BEGIN, *parts, END) == ([2, 0, 1] if last else [0, 1, 2], [])


@pytest.mark.parametrize(("size", "checksum", "notes"), [
    (0, None, []), (1, None, [LOST]), (-1, None, [DIFFER]), (0, 1, [DIFFER]), (0, 0, [])])
def test_messages_of_a_chunk_are_read_whatever_it_says_of_their_size(
    size: int, checksum: int | None, notes: list[str], file: Path
) -> None:
    records = message(0) + message(1)
    said = chunk(records, size=len(records) + size, checksum=checksum)
    found = times(file, BEGIN, said, chunk(message(2)), END)
    assert found == ([0, 1, 2], [f"{note} (1)" for note in notes])


@pytest.mark.parametrize("more", [-60, 1, 40, 1 << 20])
def test_a_message_that_claims_another_length_costs_itself_alone(more: int, file: Path) -> None:
    damaged = message(1, more=more)
    found = times(file, BEGIN, message(0), damaged, message(2), message(3), END)
    assert found == ([0, 2, 3], [f"{SKIPPED} (1)"])


@pytest.mark.parametrize("compression", list(PACK))
def test_chunks_behind_a_damaged_record_are_found(compression: str, file: Path) -> None:
    damaged = record(ATTACHMENT, DATA, more=1 << 20)
    for behind in (chunk(message(1), compression), chunk(message(1), compression) + END):
        assert times(file, BEGIN, chunk(message(0), compression), damaged, behind) == (
            [0, 1], [f"{SKIPPED} (1)"])


def test_what_only_looks_like_a_record_is_none(file: Path) -> None:
    """Behind a damaged record: chunks of two lengths, messages that are short or of no topic."""
    damaged = record(ATTACHMENT, DATA, more=1 << 20)
    for seeming in (
        chunk(message(7), "zstd", more=1), chunk(message(7), "zstd", more=-1),
        message(7)[:1] + struct.pack("<Q", MESSAGE_FIELDS - 1) + message(7)[HEAD:][:21],
        message(7, channel=2),
    ):
        found = times(file, BEGIN, message(0), damaged, seeming, chunk(message(1)), END)
        assert found == ([0, 1], [f"{SKIPPED} (1)"])


def test_messages_of_no_topic_are_counted(file: Path) -> None:
    found = times(file, BEGIN, message(0), message(7, channel=2), message(1), END)
    assert found == ([0, 1], [f"{SKIPPED} (1)"])


def test_a_chunk_of_absurd_size_is_read_as_far_as_it_goes(file: Path) -> None:
    content = chunk(message(0) + message(1))
    length = content.index(struct.pack("<Q", 2 * len(message(0))), HEAD + 28)
    absurd = content[:length] + bytes([255] * 8) + content[length + 8:]
    assert times(file, BEGIN, absurd, chunk(message(2)), END) == ([0, 1, 2], [])


def test_records_that_no_chunk_holds_end_none(file: Path) -> None:
    """Neither the data's end nor a chunk: it could hold itself, unpacked without end."""
    odd = chunk(message(0) + record(DATA_END, bytes(4)) + message(1))
    assert times(file, BEGIN, odd, chunk(message(2)), END) == ([0, 1, 2], [])
    odd = chunk(message(0) + chunk(message(7), "zstd") + message(1))
    assert times(file, BEGIN, odd, END) == ([0, 1], [f"{SKIPPED} (1)"])


@pytest.mark.parametrize("chunked", [False, True])
def test_a_damaged_length_costs_no_record_before_it(chunked: bool, file: Path) -> None:
    records = [message(1), message(2), message(3, more=ABSURD), message(4)]
    parts = [chunk(b"".join(records))] if chunked else records
    assert times(file, BEGIN, *parts, END)[0] == [1, 2, 4]


@pytest.mark.parametrize("behind", [b"", message(2)], ids=["last", "in the middle"])
def test_a_message_without_data_is_found_behind_a_damaged_one(behind: bytes, file: Path) -> None:
    content = BEGIN + message(0, more=1 << 20) + message(1, b"") + behind
    found, notes = salvaged(file, content)
    assert found == [(1, b""), (2, DATA)][:1 + bool(behind)]
    assert notes == [f"{SKIPPED} (1)"]


def test_a_message_shorter_than_its_fields_costs_itself_alone(file: Path) -> None:
    for size in range(MESSAGE_FIELDS):
        short = record(MESSAGE, message(1)[HEAD:HEAD + size])
        found = times(file, BEGIN, message(0), short, message(2))
        assert found == ([0, 2], [f"{SKIPPED} (1)"])
    # And as the last record, of which nothing is there but its head.
    assert times(file, BEGIN, message(0), record(MESSAGE, b"")) == ([0], [f"{SKIPPED} (1)"])


@pytest.mark.parametrize("zeros", [1, 8, 9, 10, 100])
def test_a_length_that_leads_to_zeros_is_no_length(zeros: int, file: Path) -> None:
    """A message whose end, by its damaged length, lies in a part of the disk that is empty."""
    found = times(file, BEGIN, message(0, more=30), bytes(30 + zeros), message(1), message(2))
    assert found[0] == [1, 2]


def test_zeros_at_the_end_of_a_file_cost_no_message_but_the_last(file: Path) -> None:
    for zeros in range(40):
        found, _ = times(file, BEGIN, message(0), message(1), bytes(zeros))
        # Nine zeros are a head, of a record that there is not.
        assert found == ([0, 1] if zeros < HEAD else [0])


def test_a_large_record_at_the_end_does_no_harm(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may be larger than what is read at once, and is believed where it ends with the file."""
    monkeypatch.setattr(salvage_mcap, "MOST_AT_ONCE", 16)
    assert times(file, BEGIN, message(0), record(ATTACHMENT, DATA)) == ([0], [])
    assert times(file, BEGIN, message(0), record(ATTACHMENT, DATA, more=1)) == ([], [])


def test_messages_whose_topic_is_named_at_the_end_only_are_read(file: Path) -> None:
    # Its content is the schema's number, and no name.
    damaged = record(CHANNEL, b"\x01")
    found = times(file, MAGIC, damaged, chunk(message(0) + message(1)), END)
    assert found == ([0, 1], [f"{SKIPPED} (1)"])
