# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Progress on standard error, as a bar or a line every 10 s; lines for users."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from typing import Any, TypeVar

from uw_visibility.errors import LONGEST_MESSAGE, printable

# Between lines, and between looks for what a first line says, s.
PERIOD, LOOK = 10.0, 0.5


class Progress:
    """Progress: frames done, rate, and time left.

    The clock starts when the first frame is done, to exclude compiling and loading of kernels.
    """

    def __init__(self, name: str, total: int | None) -> None:
        self._name = printable(name)
        self._total = total
        self._bar: Any = None
        waiting = f"{name}: no frame is done yet; the first run compiles, for a minute or two"
        self._waiting = threading.Timer(PERIOD, say, [waiting], {"error": True})
        self._waiting.daemon = True
        self._waiting.start()

    def add(self) -> None:
        if self._bar is not None:
            self._bar.update()
            return
        from tqdm import tqdm

        self._waiting.cancel()
        # Lines instead of a bar, where standard error is no terminal.
        of, left = (" of {total_fmt}", ", {remaining} left") if self._total else ("", "")
        lines: dict[str, Any] = {
            "bar_format": f"{{desc}}: {{n_fmt}}{of} frames, {{rate_noinv_fmt}}{left}\n",
            "unit": " frames", "mininterval": PERIOD, "miniters": 1, "delay": PERIOD}
        # Initial frames do not count for the rate.
        self._bar = tqdm(
            desc=self._name, total=self._total, file=sys.stderr, initial=1,
            **({"unit": "frame", "dynamic_ncols": True} if sys.stderr.isatty() else lines),
        )

    def close(self) -> None:
        self._waiting.cancel()
        if self._bar is not None:
            self._bar.close()


Item = TypeVar("Item")


def progress_bar(items: Iterable[Item], name: str, total: int | None = None) -> Iterator[Item]:
    """Yield the items, and show the progress."""
    with closing(Progress(name, total)) as progress:
        for item in items:
            yield item
            progress.add()


@contextmanager
def compiling() -> Iterator[None]:
    """Print to standard error, at once and every `PERIOD`, how many kernels were compiled."""
    # Numba loads slowly.
    from uw_visibility.compute.jit import counts

    done, before = threading.Event(), counts.compiled

    def watch() -> None:
        told = -PERIOD
        while not done.wait(min(LOOK, PERIOD)):
            compiled, now = counts.compiled - before, time.monotonic()
            if compiled > 0 and now - told >= PERIOD:
                told = now
                say(f"compiling, kernels so far: {compiled}", error=True)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        done.set()
        watcher.join()


def tell(text: str) -> None:
    """Write a line to standard error, if that is a terminal."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr)


def say(line: str, *, error: bool = False) -> None:
    """Print a line, which may contain text from outside: names of topics, files and frames."""
    print(printable(line, LONGEST_MESSAGE), file=sys.stderr if error else sys.stdout)
