# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reader of SQLite recordings from untrusted sources.

A database may contain code: views, generated columns and cycles of pages can run without end.
Only plain tables are read, within limits, and only rows with the types of a message.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from uw_visibility.errors import InputError, printable
from uw_visibility.replay.bags.source import MOST_AT_ONCE
from uw_visibility.replay.bags.storage import Channel, Part, Recorded

DEFINITIONS = "message_definitions"
# Least bytes of a row, and most steps of the virtual machine of SQLite per row.
LEAST_ROW, MOST_STEPS = 8, 100
STEPS_AT_ONCE = 1_000_000
# Ends of the names of logs of SQLite: the newest pages, or those before them.
LOGS = ("-wal", "-journal")
# Errors that a damaged database causes.
ERRORS = (sqlite3.Error, OverflowError, MemoryError)


class SqliteFile:
    """SQLite recording; a `Storage`.

    Raises `InputError` if it has no topics, or its tables are not plain.
    Raises `sqlite3.Error` if it is damaged.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._size = path, path.stat().st_size
        self.damage: list[str] = []
        self.channels: list[Channel] = []
        self.span: tuple[int, int] | None = None
        self._topics: dict[int, Channel] = {}
        # `_connect` ignores logs, since it changes nothing.
        logs = (Path(f"{path}{end}") for end in LOGS)
        log = next((log for log in logs if log.is_file() and log.stat().st_size), None)
        if log is not None:
            self._note(
                f"is incomplete without {log.name}, which a crash leaves, or a recording that goes "
                f"on: copy both, run sqlite3 {path.name} .tables on the copy, which merges them, "
                "and replay the copy")
        self._database = self._connect()
        try:
            self._read_topics()
        except BaseException as error:
            self._database.close()
            if log is not None and isinstance(error, (sqlite3.Error, InputError)):
                raise InputError(f"cannot read bag {path}: {self.damage[0]}") from error
            raise

    def messages(self, part: Part) -> Iterator[Recorded]:
        """Yield messages in the order of time, up to the first damage."""
        refused = size = 0
        try:
            # A message may be stored after a later one.
            for number, time, data in self._run(
                f"SELECT topic_id, timestamp, data FROM messages {self._where(part)} "
                "ORDER BY timestamp"
            ):
                about = self._topics.get(number)
                if about is None or not isinstance(time, int) or not isinstance(data, bytes):
                    refused += 1
                    continue
                size += LEAST_ROW + len(data)
                if size > self._size:
                    raise sqlite3.DatabaseError("more messages than fit into the file")
                yield Recorded(about.topic, about.type, time, data)
        except ERRORS as error:
            self._note_damage(error)
        if refused:
            self._note(f"has {refused} rows that are not messages")

    def close(self) -> None:
        self._database.close()

    def _connect(self) -> sqlite3.Connection:
        address = f"{self._path.absolute().as_uri()}?mode=ro&immutable=1"
        database = sqlite3.connect(address, uri=True)
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_AT_ONCE)
        # Invalid UTF-8 is replaced, not refused.
        database.text_factory = lambda data: data.decode(errors="replace")
        database.execute("PRAGMA trusted_schema=OFF")
        # Otherwise SQLite refuses a truncated file.
        database.execute("PRAGMA writable_schema=ON")
        return database

    def _read_topics(self) -> None:
        self._check_tables()
        definitions = self._definitions()
        for number, topic, kind in self._run("SELECT id, name, type FROM topics"):
            if isinstance(topic, str) and isinstance(kind, str):
                form, definition = definitions.get(kind, ("", ""))
                self._topics[number] = Channel(topic, kind, form, definition)
        if not self._topics:
            raise InputError(f"cannot read bag {self._path}: it has no topics")
        self.channels = list(self._topics.values())
        try:
            counts = dict(self._run("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
            ((first, last),) = self._run("SELECT MIN(timestamp), MAX(timestamp) FROM messages")
        except ERRORS as error:
            self._note_damage(error)
            return
        if isinstance(first, int) and isinstance(last, int):
            self.span = first, last
        unnamed = sum(count for number, count in counts.items() if number not in self._topics)
        if unnamed:
            self._note(f"{unnamed} messages are of topics that it does not name")
        self.channels = [
            replace(c, count=counts.get(number, 0)) for number, c in self._topics.items()]

    def _check_tables(self) -> None:
        """Refuse views, virtual tables and computed columns."""
        query = "SELECT name, type, rootpage FROM sqlite_master WHERE name IN (?, ?, ?)"
        for name, kind, root in self._run(query, ("topics", "messages", DEFINITIONS)):
            plain = kind == "table" and isinstance(root, int) and root > 0
            hidden = [row[6] for row in self._run(f"PRAGMA table_xinfo({name})")] if plain else [1]
            if any(hidden):
                raise InputError(
                    f"{self._path.name} is not a recording: {printable(name)} is no plain table"
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
        return f"WHERE {' AND '.join(conditions)}"

    def _run(self, query: str, values: tuple[Any, ...] = ()) -> Iterator[Any]:
        """Yield the rows of a query; too many steps raise an error."""
        most = MOST_STEPS * (self._size // LEAST_ROW) // STEPS_AT_ONCE + 10
        steps = 0

        def count() -> bool:
            nonlocal steps
            steps += 1
            return steps > most

        self._database.set_progress_handler(count, STEPS_AT_ONCE)
        yield from self._database.execute(query, values)

    def _note_damage(self, error: BaseException) -> None:
        name = self._path.name
        self._note(
            f"is damaged ({error}): read up to the damage; for the rest, run "
            f"sqlite3 {name} .recover | sqlite3 mended.db3, and replay mended.db3")

    def _note(self, what: str) -> None:
        note = f"{self._path.name} {what}"
        if note not in self.damage:
            self.damage.append(note)
