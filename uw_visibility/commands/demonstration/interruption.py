# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Deferred signals: the demonstration ends where everything can be put away."""

from __future__ import annotations

import signal
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interruption:
    """Signal handlers that only note the signal; to be used in a ``with`` statement.

    An exception raised by a signal's handler can come up in a callback of the
    compiler or of the middleware, which swallows it. So the handler only takes
    a note, and the work asks for it between two frames. A second signal does
    not wait that long.
    """

    def __init__(self) -> None:
        self._asked = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruption:
        self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal has come."""
        if self._asked:
            raise KeyboardInterrupt

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True

    def __exit__(self, *details: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
