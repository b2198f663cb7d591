# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Random access to the bytes of a recording, with limited reads."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator
from pathlib import Path, PosixPath
from typing import Any, BinaryIO

from uw_visibility.config.files import check_regular

MOST_AT_ONCE = 256 << 20
"""Largest read, bytes: more than any message or usual chunk."""
BLOCK = 1 << 20
# Overlap of blocks, longer than any pattern.
OVERLAP = 256


class LimitError(Exception):
    """More bytes are requested at once than allowed."""


class Source:
    """Random access to the `size` bytes of a file, or of a chunk in memory."""

    def __init__(self, content: Path | bytes) -> None:
        self._file = open_regular(content) if isinstance(content, Path) else io.BytesIO(content)
        self.size = self._file.seek(0, io.SEEK_END)

    def read(self, at: int, length: int) -> bytes:
        """Return bytes from an offset on, fewer at the end; `LimitError` for too many."""
        length = max(0, min(length, self.size - at)) if at >= 0 else 0
        if length > MOST_AT_ONCE:
            raise LimitError(f"a record claims {length} bytes")
        self._file.seek(at)
        return self._file.read(length)

    def find(self, pattern: re.Pattern[bytes], at: int) -> Iterator[int]:
        """Yield the offsets of a pattern from an offset on."""
        while at < self.size:
            block = self.read(at, BLOCK + OVERLAP)
            for match in pattern.finditer(block):
                if match.start() < BLOCK:
                    yield at + match.start()
            at += BLOCK

    def __enter__(self) -> Source:
        return self

    def __exit__(self, *details: object) -> None:
        self._file.close()


class _LimitedFile(io.BufferedReader):
    """File that refuses to read more than `MOST_AT_ONCE` bytes at once."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is None or size < 0:
            size = os.fstat(self.fileno()).st_size - self.tell()
        if size > MOST_AT_ONCE:
            raise LimitError(f"a record claims {size} bytes")
        return super().read(max(size, 0))


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file; it refuses to read more than `MOST_AT_ONCE` bytes at once.

    Raises `InputError` if it is not a regular file.
    """
    check_regular(path, "bag")
    return _LimitedFile(io.FileIO(path))


class RecordingPath(PosixPath):
    """Path of a file for rosbags, which reads it with limits."""

    def open(self, *_args: Any, **_kwargs: Any) -> BinaryIO:  # type: ignore[override]
        return open_regular(self)
