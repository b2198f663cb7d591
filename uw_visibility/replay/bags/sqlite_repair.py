# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Repair of a SQLite recording's header and schema.

A wrong bit in the first page hides all others. What belongs there is known: the header
(https://www.sqlite.org/fileformat.html, section 1.3) and two tables.
"""

from __future__ import annotations

import difflib
import re
import sqlite3
import struct

MAGIC = b"SQLite format 3\0"
HEADER, LEAF = 100, 13
PAGE_SIZES = (4096, *(1 << k for k in range(9, 16)))
# Columns in the order in which they are stored; more may follow.
COLUMNS = {
    "messages": "id INTEGER PRIMARY KEY, topic_id, timestamp, data",
    "topics": "id INTEGER PRIMARY KEY, name, type",
    "message_definitions":
        "id INTEGER PRIMARY KEY, topic_type, encoding, encoded_message_definition",
}
# A row of the table of tables, as it lies in the first page: name twice, root, statement.
ROW = re.compile(rb"(messages|topics|message_definitions)\1(.{1,4}?)CREATE TABLE", re.DOTALL)


def repaired(content: bytes) -> sqlite3.Connection | None:
    """Database in memory whose header and schema are those of a recording.

    Returns
    -------
    Connection or None
        None where it holds no tables of a recording.
    """
    if len(content) < HEADER:
        return None
    (stated,) = struct.unpack_from(">H", content, 16)
    for size in (stated, *PAGE_SIZES) if stated in PAGE_SIZES else PAGE_SIZES:
        roots = _roots(content, size)
        if {"messages", "topics"} <= roots.keys():
            database = sqlite3.connect(":memory:")
            try:
                database.deserialize(_with_schema(content, size))
                _declare(database, roots)
            except (sqlite3.Error, OverflowError, MemoryError):
                # Another size of pages may do.
                database.close()
            else:
                return database
    return None


def _with_header(content: bytes, page_size: int) -> bytes:
    """Return a database with the header of a recording's."""
    head = bytearray(content[:HEADER])
    head[:16] = MAGIC
    # Versions of a database without a journal, nothing reserved, and constants.
    head[16:24] = struct.pack(">H6B", page_size, 1, 1, 0, 64, 32, 32)
    # Of how many pages it is.
    head[24:32] = struct.pack(">II", 1, len(content) // page_size)
    head[32:40] = bytes(8)
    head[44:48] = struct.pack(">I", 4)
    head[56:60] = struct.pack(">I", 1)
    head[92:96] = struct.pack(">I", 1)
    return bytes(head) + content[HEADER:]


def _with_schema(content: bytes, page_size: int) -> bytes:
    """Return a database whose table of tables is empty."""
    empty = struct.pack(">BHHHB", LEAF, 0, 0, page_size, 0)
    whole = _with_header(content, page_size)
    first = whole[:HEADER] + empty + bytes(page_size - HEADER - len(empty))
    return first + whole[page_size:]


def _roots(content: bytes, page_size: int) -> dict[str, int]:
    """Return where tables begin: as the table of tables says, or else its bytes."""
    roots: dict[str, int] = {}
    database = sqlite3.connect(":memory:")
    try:
        database.deserialize(_with_header(content, page_size))
        database.execute("PRAGMA writable_schema=ON")
        query = "SELECT name, rootpage FROM sqlite_master WHERE type != 'index'"
        for name, root in database.execute(query):
            near = difflib.get_close_matches(str(name), COLUMNS, 1, 0.8)
            if near and isinstance(root, int) and root > 1:
                roots.setdefault(near[0], root)
    except (sqlite3.Error, OverflowError, MemoryError):
        # What was found so far holds.
        pass
    finally:
        database.close()
    for match in ROW.finditer(content[:page_size]):
        roots.setdefault(match[1].decode(), int.from_bytes(match[2], "big"))
    return roots


def _declare(database: sqlite3.Connection, roots: dict[str, int]) -> None:
    """Write the tables into the table of tables, which is empty."""
    database.execute("PRAGMA trusted_schema=OFF")
    database.execute("PRAGMA writable_schema=ON")
    for name, columns in COLUMNS.items():
        if name in roots:
            database.execute(
                "INSERT INTO sqlite_master(type, name, tbl_name, rootpage, sql) "
                "VALUES ('table', ?, ?, ?, ?)",
                (name, name, roots[name], f"CREATE TABLE {name}({columns})"),
            )
    database.commit()
    # So that it is read anew.
    database.execute("PRAGMA schema_version = 2")
