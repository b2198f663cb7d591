# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Where a result comes from: version, parameters, and the input's hash."""

from __future__ import annotations

import hashlib
import importlib.metadata
import threading
from collections.abc import Sequence
from pathlib import Path

BLOCK = 1 << 20


def version() -> str:
    """Return the version of the package, or "unknown" where it is not installed."""
    try:
        return importlib.metadata.version("uw_visibility")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def fingerprint(files: Sequence[Path]) -> str:
    """Return what tells whether files are the same as before, at once: sizes, and their ends."""
    total = hashlib.sha256()
    for path in files:
        size = path.stat().st_size
        total.update(f"{path.name} {size}\n".encode())
        with path.open("rb") as file:
            total.update(file.read(BLOCK))
            file.seek(max(size - BLOCK, 0))
            total.update(file.read(BLOCK))
    return total.hexdigest()


class FileHash:
    """SHA-256 of files, computed beside other work.

    Parameters
    ----------
    files : sequence of Path
        Files in order; the hash is that of their contents one after the other.
    """

    def __init__(self, files: Sequence[Path]) -> None:
        self._files = list(files)
        self._hash = hashlib.sha256()
        self._stop = threading.Event()
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def result(self) -> str:
        """Wait and return the hash, as hexadecimal digits."""
        self._thread.join()
        if self._error is not None:
            return f"not readable: {self._error.strerror}"
        return "not computed" if self._stop.is_set() else self._hash.hexdigest()

    def stop(self) -> None:
        """Give up."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        try:
            for path in self._files:
                with path.open("rb") as file:
                    while not self._stop.is_set() and (block := file.read(BLOCK)):
                        self._hash.update(block)
        except OSError as error:
            self._error = error
