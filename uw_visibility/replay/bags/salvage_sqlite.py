# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Salvage of SQLite files that are cut off or damaged: the rows that can be reached."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path

from uw_visibility.replay.bags.storage import Channel, Recorded, wanted

# Rows are numbered from 1; after so many in a row that are not there, none is expected.
LONGEST_GAP = 1000


class SqliteSalvage:
    """Reads a damaged database row by row; a `Storage` without an index."""

    span = None

    def __init__(self, path: Path) -> None:
        self._name = path.name
        self._database = sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)
        self.damage: list[str] = []
        self._topics: dict[int, Channel] = {}
        try:
            # SQLite refuses files that are shorter than their header says, but for repairs.
            self._database.execute("PRAGMA writable_schema=ON")
            definitions = self._definitions()
            for number, topic, kind in self._database.execute("SELECT id, name, type FROM topics"):
                form, definition = definitions.get(kind, ("", ""))
                self._topics[number] = Channel(topic, kind, form, definition)
        except sqlite3.Error as error:
            self.damage.append(f"{self._name}: the table of topics cannot be read: {error}")
        self.channels = list(self._topics.values())

    def messages(
        self, topics: Collection[str] | None, start: int | None, stop: int | None
    ) -> Iterator[Recorded]:
        """Yield messages in the order in which they were recorded."""
        number = missing = lost = 0
        while missing < LONGEST_GAP:
            number += 1
            row = self._row(number)
            if row is None:
                missing += 1
                continue
            lost += missing
            missing = 0
            about = self._topics.get(row[0])
            if about is None:
                continue
            message = Recorded(about.topic, about.type, row[1], row[2])
            if wanted(message, topics, start, stop):
                yield message
        if lost:
            self.damage.append(f"{self._name}: {lost} messages among others are lost")

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def _row(self, number: int) -> tuple[int, int, bytes] | None:
        """Return topic, time and data of a row, or None where it is not there or lost."""
        query = "SELECT topic_id, timestamp, data FROM messages WHERE id = ?"
        try:
            row = self._database.execute(query, (number,)).fetchone()
        except sqlite3.DatabaseError:
            return None
        return None if row is None else (int(row[0]), int(row[1]), bytes(row[2]))

    def _definitions(self) -> dict[str, tuple[str, str]]:
        try:
            rows = self._database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            ).fetchall()
        except sqlite3.Error:
            # Recordings of older distributions have no such table.
            return {}
        return {kind: (encoding.removeprefix("ros2"), text) for kind, encoding, text in rows}
