# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Progress of a replay: a bar on a terminal, a line every 10 s elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, Protocol, TextIO

PERIOD = 10.0


class Counter(Protocol):
    """What is told of each frame that is done."""

    def add(self) -> None:
        """Count a frame."""

    def close(self) -> None:
        """End the counting."""


MakeCounter = Callable[[str, int | None], Counter]
"""Makes the counter of a recording, of its name and of its frames, where their number is known."""


class Progress:
    """Progress: frames done, rate, and time left.

    The clock begins with the first frame that is done: before it, kernels are compiled or
    loaded, which says nothing of the time that frames take.

    Parameters
    ----------
    name : str
        What is replayed.
    total : int or None
        Frames expected, where that is known.
    stream : TextIO, optional
        Where to; standard error.
    tell : callable, optional
        What takes lines in place of the stream.
    """

    def __init__(
        self, name: str, total: int | None, stream: TextIO | None = None,
        tell: Callable[[str], object] | None = None,
    ) -> None:
        self._stream = stream or sys.stderr
        self._tell = tell
        self._name = name
        self._total = total
        self._count = 0
        self._begin = self._told = time.monotonic()
        self._bar: Any = None

    def add(self) -> None:
        """Count a frame."""
        self._count += 1
        if self._count == 1:
            self._start()
            return
        if self._bar is not None:
            self._bar.update()
            return
        now = time.monotonic()
        if now - self._told >= PERIOD:
            self._told = now
            line = self._line(now - self._begin)
            if self._tell is not None:
                self._tell(line)
            else:
                print(line, file=self._stream, flush=True)

    def _start(self) -> None:
        self._begin = self._told = time.monotonic()
        if self._tell is None and self._stream.isatty():
            from tqdm import tqdm

            # What is there to begin with does not count for the rate.
            self._bar = tqdm(
                desc=self._name, total=self._total, file=self._stream, unit="frame",
                dynamic_ncols=True, initial=1,
            )

    def close(self) -> None:
        """End the bar."""
        if self._bar is not None:
            self._bar.close()

    def _line(self, elapsed: float) -> str:
        rate = (self._count - 1) / elapsed
        line = f"{self._name}: {self._count}"
        if self._total is None or self._total < self._count:
            return f"{line} frames, {rate:.1f} frames/s"
        left = round((self._total - self._count) / rate)
        return (
            f"{line} of {self._total} frames, {rate:.1f} frames/s, "
            f"{left // 60}:{left % 60:02d} min left"
        )
