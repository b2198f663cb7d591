# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A thread that always takes the newest item, so that nobody waits for it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class NewestWorker(Generic[Item]):
    """Processes items in a thread of its own; of those that wait only the newest is kept.

    Parameters
    ----------
    process : callable
        Called in the thread with each item. It must not raise.
    prepare : callable
        Called in the thread once, before the first item. It must not raise.

    Attributes
    ----------
    skipped : int
        Items that a newer one replaced before their turn came.
    """

    def __init__(
        self, process: Callable[[Item], None], prepare: Callable[[], None] = lambda: None
    ) -> None:
        self.skipped = 0
        self._process = process
        self._prepare = prepare
        self._item: Item | None = None
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
            self.skipped += self._item is not None
            self._item = item
            self._changed.notify()

    def stop(self, timeout: float) -> bool:
        """Take no further item.

        Parameters
        ----------
        timeout : float
            How long to wait for the item that is being processed, s.

        Returns
        -------
        bool
            Whether the thread has ended.
        """
        with self._changed:
            self._stopping = True
            self._changed.notify()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        self._prepare()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._stopping or self._item is not None)
                if self._stopping:
                    return
                item, self._item = self._item, None
            if item is not None:
                self._process(item)
