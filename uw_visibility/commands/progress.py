# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Progress bar on standard error, where that is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")


def progress_bar(items: Iterable[Item], name: str, total: int | None = None) -> Iterator[Item]:
    """Yield the items and advance a progress bar."""
    from tqdm import tqdm

    yield from tqdm(
        items, name, total, disable=not sys.stderr.isatty(), dynamic_ncols=True, unit="frame"
    )


def tell(text: str) -> None:
    """Write a line to standard error, where that is a terminal."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr)
