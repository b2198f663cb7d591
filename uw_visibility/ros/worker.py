# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Worker thread that takes the newest item and drops older ones."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class NewestWorker(Generic[Item]):
    """Processes items one after the other in a thread of its own; the newest waits, others go.

    process: called with each item. It must not raise.
    prepare: called in the thread once, before the first item. It must not raise.
    niceness: how far the thread, and those that it starts, give way to others: 0 not at all, 19
        most. Only Linux knows it of single threads; elsewhere it does nothing.
    skipped: items that a newer one replaced before their turn came.
    """

    def __init__(
        self,
        process: Callable[[Item], None],
        prepare: Callable[[], None] = lambda: None,
        niceness: int = 0,
    ) -> None:
        self.skipped = 0
        self._niceness = niceness
        self._process = process
        self._prepare = prepare
        # The item that waits, if any.
        self._waiting: list[Item] = []
        self._stopping = False
        self._changed = threading.Condition()
        # A daemon, since an item that takes long must not hold up the exit.
        self._thread = threading.Thread(target=self._run, name="pipeline", daemon=True)

    @property
    def stopping(self) -> bool:
        """Whether `stop` was called, so that results are no longer wanted."""
        return self._stopping

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def offer(self, item: Item) -> None:
        """Hand over an item, instead of the one that waits; returns at once."""
        with self._changed:
            self.skipped += len(self._waiting)
            self._waiting = [item]
            self._changed.notify_all()

    def stop(self, timeout: float) -> bool:
        """Take no further item.

        timeout: how long to wait for the item that is being processed, s.
        Returns whether the thread has ended.
        """
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        if sys.platform == "linux":
            thread = threading.get_native_id()
            own = os.getpriority(os.PRIO_PROCESS, thread)
            os.setpriority(os.PRIO_PROCESS, thread, min(own + self._niceness, 19))
        self._prepare()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._stopping or self._waiting)
                if self._stopping:
                    return
                item = self._waiting.pop()
            self._process(item)
