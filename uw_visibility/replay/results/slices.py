# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Typed slices of a table, so that one of any length is written in bounded memory."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uw_visibility.replay.columns import Column
from uw_visibility.replay.table import read_rows

ROWS = 1024
"""Rows of a slice."""


def slices(
    path: Path, columns: Mapping[str, Column], rows: int = ROWS
) -> Iterator[dict[str, NDArray]]:
    """Yield a table's columns in slices of rows; one without rows where there are none.

    Parameters
    ----------
    path : Path
        The table.
    columns : mapping of str to Column
    rows : int
        Rows of a slice.

    Yields
    ------
    dict of str to ndarray, (n,)
        float64 for numbers, NaN where they are not known; object (str) for texts.

    Raises
    ------
    InputError
        If the table is damaged.
    """
    found = read_rows(path)
    for number in itertools.count():
        part = list(itertools.islice(found, rows))
        if not part and number:
            return
        yield {
            name: np.array([float(row[name] or "nan") for row in part])
            if column.kind in ("integer", "number")
            else np.array([row[name] for row in part], dtype=object)
            for name, column in columns.items()
        }
