# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings that are damaged where it hurts: in their structure, by whoever knows it."""

from __future__ import annotations

import random
import sqlite3
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml
from mutations import ABSURD

ABSURD_VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 2**31, 2**63 - 1, -(2**63), 1e300, -1e300, float("nan"), float("inf"),
    "", "\0", "x" * 300, "../" * 50 + "etc/passwd", "/dev/zero", "\x1b[2J", "\u202e", "é" * 5000,
    [], {}, [[]], [None], {"a": {}}, [1] * 1000,
)

TIMES = "UPDATE messages SET timestamp = {}"
SQL = (
    *(TIMES.format(value) for value in ("NULL", "-1", "1e300", "'now'", "9223372036854775807",
                                        "x'00'", "timestamp * 1.5", "-timestamp")),
    *(f"UPDATE messages SET data = {value}" for value in (
        "NULL", "7", "2000000000", "1e9", "'text'", "x''", "x'00'",
        "zeroblob(400000000) WHERE id = 1", "zeroblob(40)", "data || data")),
    *(f"UPDATE messages SET topic_id = {value}" for value in ("NULL", "'a'", "1e9", "-1", "x'01'")),
    "UPDATE messages SET id = id * 1000000007",
    "UPDATE messages SET id = -id",
    *(f"UPDATE topics SET {column} = {value}" for column in (
        "name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash")
      for value in ("NULL", "''", "7", "x'ff00'", "char(27) || '[2J'", "hex(zeroblob(50000))",
                    "'sensor_msgs/msg/Imu'")),
    "UPDATE topics SET offered_qos_profiles = replace(hex(zeroblob(2000)), '00', '[')",
    *(f"UPDATE message_definitions SET {column} = {value}" for column in (
        "topic_type", "encoding", "encoded_message_definition")
      for value in ("NULL", "7", "x'ff'", "'' || hex(zeroblob(50000))")),
    "DELETE FROM topics", "DELETE FROM messages", "DROP TABLE messages", "DROP TABLE topics",
    "DROP TABLE schema", "UPDATE schema SET schema_version = 999",
    "UPDATE schema SET schema_version = 'x'",
    "DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL "
    "SELECT id + 1 FROM n) SELECT id, 1 AS topic_id, id AS timestamp, zeroblob(100000) AS data "
    "FROM n",
    "DROP TABLE topics; CREATE VIEW topics AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT "
    "id + 1 FROM n) SELECT id, 'a' || id AS name, 'std_msgs/msg/Float64' AS type, 'cdr' AS "
    "serialization_format, '' AS offered_qos_profiles, '' AS type_description_hash FROM n",
    "DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
    "timestamp INTEGER, data BLOB AS (zeroblob(1000000000))); "
    "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1), (1, 2), (2, 2)",
    "DROP INDEX timestamp_idx",
)


def damage_database(path: Path, rng: random.Random) -> str:
    """Change a database by a statement or two; returns which."""
    statements = rng.sample(SQL, rng.choice((1, 1, 2)))
    database = sqlite3.connect(path)
    with suppress(sqlite3.Error):
        # What the tables declare of their columns would not let all of it in.
        database.execute("PRAGMA writable_schema=ON")
        database.execute("UPDATE sqlite_master SET sql = replace(sql, ' NOT NULL', '')")
        database.commit()
    database.close()
    for statement in statements:
        database = sqlite3.connect(path)
        with suppress(sqlite3.Error):
            database.executescript(statement)
            database.commit()
        database.close()
    return "; ".join(statement[:60] for statement in statements)


def damage_metadata(path: Path, rng: random.Random) -> str:
    """Put an absurd value at some place of metadata.yaml; returns where and what."""
    content = yaml.safe_load(path.read_text())
    value, place = rng.choice(ABSURD_VALUES), []
    node = content
    while True:
        keys = list(range(len(node))) if isinstance(node, list) else list(node)
        key = rng.choice(keys)
        place.append(key)
        inner = node[key]
        if not isinstance(inner, dict | list) or not inner or rng.random() < 0.2:
            node[key] = value
            break
        node = inner
    path.write_text(yaml.safe_dump(content))
    return f"{'.'.join(map(str, place[1:]))} = {str(value)[:20]!r}"


def damage_mcap(data: bytes, rng: random.Random) -> bytes:
    """Put absurd numbers into the heads of records, of the file and of its chunks."""
    places = []
    at = 8
    while at + 9 <= len(data):
        kind, length = struct.unpack_from("<BQ", data, at)
        places.append(at)
        if kind == 6:
            inner = at + 9 + 40
            while inner + 9 < at + 9 + length:
                places.append(inner)
                inner += 9 + struct.unpack_from("<Q", data, inner + 1)[0]
        at += 9 + length
    return _at_some(data, places, range(40), rng)


def _at_some(data: bytes, places: list[int], offsets: range, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        begin = rng.choice(places) + rng.choice(offsets)
        number = rng.choice((*ABSURD, rng.randbytes(1), rng.randbytes(4)))
        if 0 <= begin < len(data) - len(number):
            changed[begin : begin + len(number)] = number
    return bytes(changed)
