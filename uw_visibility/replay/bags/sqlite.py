# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reader of SQLite recordings, whole or damaged, from whoever made them.

A database is a program in part: its views, generated columns and cycles of pages can
run without end. Only plain tables are read, within limits, and of what they hold only
what has the type of a message.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from uw_visibility.config.files import check_regular
from uw_visibility.errors import InputError, printable
from uw_visibility.replay.bags.source import MOST_AT_ONCE, Source
from uw_visibility.replay.bags.sqlite_repair import repaired
from uw_visibility.replay.bags.storage import Channel, Part, Recorded

TABLES = ("topics", "messages")
DEFINITIONS = "message_definitions"
# Rows are numbered from 1; after so many in a row that are not there, none is expected.
LONGEST_GAP = 1000
# No row takes fewer bytes of a file than this, nor more steps of SQLite's machine.
LEAST_ROW, MOST_STEPS = 8, 100
STEPS_AT_ONCE = 1_000_000
# A message may have been received a little after the next one; these are kept in order.
SORTED = "SELECT id, topic_id, timestamp, data FROM messages{} ORDER BY timestamp"
# What a damaged database raises: as errors of its own, or for the numbers in it.
ERRORS = (sqlite3.Error, OverflowError, MemoryError)


class SqliteFile:
    """SQLite recording, read row by row where it is damaged; a `Storage`.

    Raises
    ------
    InputError
        If the tables of a recording are not plain ones.
    """

    def __init__(self, path: Path) -> None:
        check_regular(path, "bag")
        self._name = path.name
        self._size = path.stat().st_size
        self.damage: list[str] = []
        self.channels: list[Channel] = []
        self.span: tuple[int, int] | None = None
        self._topics: dict[int, Channel] = {}
        self._database = self._connect(path)
        try:
            try:
                whole = self._open()
            except InputError:
                whole = False
                if not self._open_repaired(path):
                    raise
            else:
                if not whole:
                    self._open_repaired(path)
        except BaseException:
            self._database.close()
            raise

    def messages(self, part: Part) -> Iterator[Recorded]:
        """Yield messages in the order of time; where that fails, the rest as recorded."""
        refused = size = 0
        # Of the rows that were reached, the latest ones.
        latest, rows = -1, set[int]()
        try:
            for row in self._run(SORTED.format(self._where(part))):
                message = self._message(row)
                if message is None:
                    refused += 1
                    continue
                size += LEAST_ROW + len(message.data)
                if size > self._size:
                    raise sqlite3.DatabaseError("more messages than the file has room for")
                if message.time > latest:
                    latest, rows = message.time, set()
                rows.add(row[0])
                yield message
        except ERRORS as error:
            self._note(f"is damaged ({error}): read as far as it goes")
            yield from self._one_by_one(part, latest, rows)
        if refused:
            self._note(f"has {refused} rows that are no messages")

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def _connect(self, path: Path) -> sqlite3.Connection:
        address = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
        database = sqlite3.connect(address, uri=True)
        _limit(database)
        database.execute("PRAGMA trusted_schema=OFF")
        # SQLite refuses files that are shorter than their header says, but for repairs.
        database.execute("PRAGMA writable_schema=ON")
        return database

    def _open_repaired(self, path: Path) -> bool:
        """Open it with the head that it should have, if it is the head that is damaged."""
        if not 0 < self._size <= MOST_AT_ONCE:
            return False
        with Source.of(path) as source:
            database = repaired(source.read(0, source.size))
        if database is None:
            return False
        self._database.close()
        self._database = database
        _limit(database)
        self._topics.clear()
        self._open()
        return True

    def _open(self) -> bool:
        """Read topics and counts; returns whether the tables have the columns of a recording."""
        whole = True
        try:
            self._check_tables()
            definitions = self._definitions()
            for number, topic, kind in self._run("SELECT id, name, type FROM topics"):
                whole = whole and isinstance(number, int)
                if isinstance(topic, str) and isinstance(kind, str):
                    form, definition = definitions.get(kind, ("", ""))
                    self._topics[number] = Channel(topic, kind, form, definition)
        except ERRORS as error:
            self._note(f"the table of topics cannot be read: {error}")
            whole = False
        counts: dict[int, int] | None = {}
        try:
            counts = dict(self._run("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
            ((first, last),) = self._run("SELECT MIN(timestamp), MAX(timestamp) FROM messages")
            if isinstance(first, int) and isinstance(last, int):
                self.span = first, last
        except ERRORS as error:
            counts = None
            self._note(f"is damaged ({error}): read as far as it goes")
        nowhere = sum(n for number, n in (counts or {}).items() if number not in self._topics)
        if nowhere:
            self._note(f"{nowhere} messages are of topics that it does not name")
        self.channels = [
            replace(c, count=None if counts is None else counts.get(number, 0))
            for number, c in self._topics.items()
        ]
        try:
            list(self._run(SORTED.format(" WHERE id = 0")))
        except sqlite3.OperationalError:
            whole = False
        except ERRORS:
            # Damage within, which reading goes around.
            pass
        return whole

    def _check_tables(self) -> None:
        """Refuse views, virtual tables and columns that are computed.

        Raises
        ------
        InputError
            Naming what is none of a recording's tables.
        """
        query = "SELECT name, type, rootpage FROM sqlite_master WHERE name IN (?, ?, ?)"
        for name, kind, root in self._run(query, (*TABLES, DEFINITIONS)):
            plain = kind == "table" and isinstance(root, int) and root > 0
            hidden = [row[6] for row in self._run(f"PRAGMA table_xinfo({name})")] if plain else [1]
            if any(hidden):
                raise InputError(
                    f"{self._name} is no recording: its {printable(name)} are no plain table"
                )

    def _definitions(self) -> dict[str, tuple[str, str]]:
        try:
            rows = list(self._run(
                f"SELECT topic_type, encoding, encoded_message_definition FROM {DEFINITIONS}"
            ))
        except sqlite3.Error:
            # Recordings of older distributions have no such table.
            return {}
        return {
            kind: (encoding.removeprefix("ros2"), text) for kind, encoding, text in rows
            if all(isinstance(value, str) for value in (kind, encoding, text))
        }

    def _where(self, part: Part) -> str:
        numbers = ", ".join(
            str(number) for number, channel in self._topics.items()
            if (part.topics is None or channel.topic in part.topics) and isinstance(number, int)
        )
        conditions = [f"topic_id IN ({numbers})"]
        if part.start is not None:
            conditions.append(f"timestamp >= {part.start}")
        if part.stop is not None:
            conditions.append(f"timestamp < {part.stop}")
        return f" WHERE {' AND '.join(conditions)}"

    def _message(self, row: Any) -> Recorded | None:
        """Return the message of a row; None where the row is none of a recording."""
        _, number, time, data = row
        about = self._topics.get(number)
        if about is None or not isinstance(time, int) or not isinstance(data, bytes):
            return None
        return Recorded(about.topic, about.type, time, data)

    def _one_by_one(
        self, part: Part, latest: int, rows: Collection[int]
    ) -> Iterator[Recorded]:
        """Yield the messages of rows that can be reached, later than those of before."""
        number = missing = lost = 0
        query = "SELECT id, topic_id, timestamp, data FROM messages WHERE id = ?"
        last = self._last_row()
        while missing < LONGEST_GAP or number < last:
            number += 1
            try:
                row = next(self._run(query, (number,)), None)
            except ERRORS:
                row = None
            if row is None:
                missing += 1
                continue
            lost += missing
            missing = 0
            message = self._message(row)
            if message is None:
                lost += 1
            elif message.time < latest or number in rows:
                continue
            elif part.holds(message):
                yield message
        if lost:
            self._note(f"{lost} messages among others are lost")

    def _last_row(self) -> int:
        """Return the number of the last row, as far as it can be true."""
        try:
            ((last,),) = self._run("SELECT MAX(id) FROM messages")
        except ERRORS:
            return 0
        return min(last, self._size // LEAST_ROW) if isinstance(last, int) else 0

    def _run(self, query: str, values: tuple[Any, ...] = ()) -> Iterator[Any]:
        """Yield the rows of a query, which ends with an error where it takes too many steps."""
        most = MOST_STEPS * (self._size // LEAST_ROW) // STEPS_AT_ONCE + 10
        steps = 0

        def count() -> bool:
            nonlocal steps
            steps += 1
            return steps > most

        self._database.set_progress_handler(count, STEPS_AT_ONCE)
        yield from self._database.execute(query, values)

    def _note(self, what: str) -> None:
        note = f"{self._name} {what}"
        if note not in self.damage:
            self.damage.append(note)


def _limit(database: sqlite3.Connection) -> None:
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_AT_ONCE)
    # Text that is no UTF-8 is the business of whoever shows it.
    database.text_factory = lambda data: data.decode(errors="replace")
