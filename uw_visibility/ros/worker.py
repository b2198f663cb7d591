# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Worker threads that take the newest item and drop older ones."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

Item = TypeVar("Item")

# What follows within this time came together, s.
TOGETHER = 0.02


class NewestWorker(Generic[Item]):
    """Processes items in threads of its own; of those that wait only the newest are kept.

    Items that come together all wait, as many as there are threads, and the oldest goes
    first: the middleware hands over two images at once where it had to send parts of the
    first again.

    Parameters
    ----------
    process : callable
        Called with each item; returns an iterator of three parts, such as a generator
        that yields twice: the first and the last part of items are done one after the
        other, in the order in which they were taken, and those between at once. It must
        not raise.
    prepare : callable
        Called in the first thread once, before the first item. It must not raise.
    threads : int
        Items that may be processed at once.
    niceness : int
        How far these threads, and those that they start, give way to others: 0 not at
        all, 19 most. Only Linux knows it of single threads; elsewhere it does nothing.

    Attributes
    ----------
    skipped : int
        Items that a newer one replaced before their turn came.
    """

    def __init__(
        self,
        process: Callable[[Item], Iterator[None]],
        prepare: Callable[[], None] = lambda: None,
        threads: int = 1,
        niceness: int = 0,
    ) -> None:
        self.skipped = 0
        self._niceness = niceness
        self._process = process
        self._prepare = prepare
        self._items: deque[Item] = deque(maxlen=threads)
        self._offered = 0.0
        self._prepared = self._stopping = False
        self._taken = self._finished = 0
        self._changed = threading.Condition()
        # Held by the thread that takes the next item, until its first part is done.
        self._taking = threading.Lock()
        # Daemons, since an item that takes long must not hold up the exit.
        self._threads = [
            threading.Thread(target=self._run, args=(number,), name=f"pipeline {number}",
                             daemon=True)
            for number in range(threads)
        ]

    @property
    def stopping(self) -> bool:
        """Whether `stop` was called, so that results are no longer wanted."""
        return self._stopping

    def start(self) -> None:
        """Start the threads."""
        for thread in self._threads:
            thread.start()

    def offer(self, item: Item) -> None:
        """Hand over an item, instead of those that wait from before; returns at once."""
        with self._changed:
            now = time.monotonic()
            while self._items and (
                now - self._offered > TOGETHER or len(self._items) == self._items.maxlen
            ):
                self._items.popleft()
                self.skipped += 1
            self._offered = now
            self._items.append(item)
            self._changed.notify_all()

    def stop(self, timeout: float) -> bool:
        """Take no further item.

        Parameters
        ----------
        timeout : float
            How long to wait for the items that are being processed, s.

        Returns
        -------
        bool
            Whether the threads have ended.
        """
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        end = time.monotonic() + timeout
        for thread in self._threads:
            thread.join(max(end - time.monotonic(), 0.0))
        return not any(thread.is_alive() for thread in self._threads)

    def _run(self, number: int) -> None:
        if sys.platform == "linux":
            thread = threading.get_native_id()
            own = os.getpriority(os.PRIO_PROCESS, thread)
            os.setpriority(os.PRIO_PROCESS, thread, min(own + self._niceness, 19))
        if number == 0:
            self._prepare()
            with self._changed:
                self._prepared = True
                self._changed.notify_all()
        while True:
            with self._taking:
                item = self._take()
                if item is None:
                    return
                turn = self._taken
                self._taken += 1
                parts = self._process(item)
                next(parts, None)
            next(parts, None)
            self._wait_for(turn)
            next(parts, None)
            with self._changed:
                self._finished += 1
                self._changed.notify_all()

    def _take(self) -> Item | None:
        """Wait for an item; None where there will be no other."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._stopping or (self._prepared and len(self._items) > 0)
            )
            return None if self._stopping else self._items.popleft()

    def _wait_for(self, turn: int) -> None:
        """Wait until all items that were taken before are finished."""
        with self._changed:
            self._changed.wait_for(lambda: self._finished == turn)
