# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Provenance of a result: version, parameters, and hash of the input."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uw_visibility import __version__

BLOCK = 1 << 20
SAMPLE, SAMPLES = 1 << 16, 64


def fingerprint(files: Sequence[Path]) -> str:
    """Fingerprint of files: a hash of their names, sizes, and samples spread over each.

    Reading a day of recordings completely takes as long as replaying them. Files of up to 4 MiB
    are read completely.
    """
    total = hashlib.sha256()
    for path in files:
        size = path.stat().st_size
        total.update(f"{path.name} {size}\n".encode())
        with path.open("rb") as file:
            for position in (*range(0, size, max(size // SAMPLES, SAMPLE)), max(size - SAMPLE, 0)):
                file.seek(position)
                total.update(file.read(SAMPLE))
    return total.hexdigest()


@dataclass(frozen=True)
class Origin:
    """Origin of a result, with all parameters that affect it: same origin, same result."""

    # bag, fingerprint: name of the recording, and fingerprint of its files
    bag: str
    fingerprint: str
    version: str  # of the package
    parameters: dict[str, Any]

    @classmethod
    def of(cls, bag: Path, files: Sequence[Path], parameters: dict[str, Any]) -> Origin:
        """Return the origin of a new result."""
        return cls(bag.name, fingerprint(files), __version__, parameters)

    def difference(self, state: Mapping[str, Any]) -> str:
        """Return how the state of another result differs from this, as text; "" if it does not."""
        if state.get("fingerprint") != self.fingerprint:
            return f"is not of {self.bag} as it is now"
        if state.get("version") != self.version:
            return f"is of another version, {state.get('version')}"
        before = state.get("parameters")
        if not isinstance(before, Mapping):
            return "does not say with which parameters it was made"
        names = sorted({*before, *self.parameters})
        # None is a value, and differs from a missing parameter.
        changed = [
            k for k in names
            if k not in before or k not in self.parameters or before[k] != self.parameters[k]
        ]
        return f"was made with another {', '.join(changed)}" if changed else ""


def texts_of(provenance: Mapping[str, Any]) -> dict[str, str]:
    """Return a provenance as texts for metadata of files; other values as JSON."""
    return {
        name: value if isinstance(value, str) else json.dumps(value)
        for name, value in provenance.items()
    }


class FileHash:
    """SHA-256 of the contents of files, one after the other, computed in a background thread."""

    def __init__(self, files: Sequence[Path]) -> None:
        self._files = list(files)
        self._found = "not computed"
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def result(self) -> str:
        """Wait for the hash, and return it as hexadecimal digits, or why there is none."""
        self._thread.join()
        return self._found

    def stop(self) -> None:
        """Abandon the computation."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        total = hashlib.sha256()
        try:
            for path in self._files:
                with path.open("rb") as file:
                    while block := file.read(BLOCK):
                        if self._stop.is_set():
                            return
                        total.update(block)
            self._found = total.hexdigest()
        except OSError as error:
            self._found = f"not readable: {error.strerror}"
