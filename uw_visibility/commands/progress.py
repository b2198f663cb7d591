# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Progress of long work, on standard error where that is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")


def progress_bar(items: Iterable[Item], name: str, total: int | None = None) -> Iterator[Item]:
    """Yield the items, and show how many have been taken."""
    from tqdm import tqdm

    yield from tqdm(
        items, name, total, disable=not sys.stderr.isatty(), dynamic_ncols=True, unit="frame"
    )


def tell(text: str) -> None:
    """Say what is being waited for."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr)
