# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Lines on the terminal."""

from __future__ import annotations

import sys

from uw_visibility.errors import LONGEST_MESSAGE, printable


def say(line: str, *, error: bool = False) -> None:
    """Print a line, which may hold text from outside: names of topics, files and frames.

    Parameters
    ----------
    line : str
        The line.
    error : bool
        Whether it goes to standard error.
    """
    print(printable(line, LONGEST_MESSAGE), file=sys.stderr if error else sys.stdout)
