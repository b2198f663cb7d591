# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Lines on the terminal, and progress on standard error: a bar or lines, and in a log."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from uw_visibility.errors import LONGEST_MESSAGE, printable, refusing

Item = TypeVar("Item")


def progress_bar(
    items: Iterable[Item], name: str, total: int | None = None, log: logging.Logger | None = None
) -> Iterator[Item]:
    """Yield the items; tell how many there were, as `Progress` does, in a log too."""
    from uw_visibility.replay.progress import Progress

    counters = [Progress(name, total)]
    if log is not None:
        counters.append(Progress(name, total, tell=log.info))
    try:
        for item in items:
            yield item
            for counter in counters:
                counter.add()
    finally:
        for counter in counters:
            counter.close()


@contextmanager
def progress_log(path: Path | None, name: str) -> Iterator[logging.Logger | None]:
    """Open a log of long work, with dated lines: its begin, its progress, its end or failure.

    Parameters
    ----------
    path : Path or None
        File to add to; None yields None.
    name : str
        What the work is.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    if path is None:
        yield None
        return
    with refusing(f"cannot write log {path}"):
        handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(message)s", "%Y-%m-%dT%H:%M:%S%z"))
    # Of no one else's loggers, and no one else's.
    log = logging.Logger("uw_visibility")
    log.addHandler(handler)
    log.info("%s: begins", name)
    try:
        yield log
    except BaseException as error:
        log.info("%s: ended by %s", name, str(error) or type(error).__name__)
        raise
    else:
        log.info("%s: done", name)
    finally:
        handler.close()


def tell(text: str) -> None:
    """Write a line to standard error, where that is a terminal."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr)


def say(line: str, *, error: bool = False) -> None:
    """Print a line, which may hold text from outside: names of topics, files and frames."""
    print(printable(line, LONGEST_MESSAGE), file=sys.stderr if error else sys.stdout)
