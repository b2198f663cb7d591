# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Worker threads that process the newest item and drop older ones that wait."""

from __future__ import annotations

import functools
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

Item = TypeVar("Item")


class Turn(NamedTuple):
    """Lane (thread) of an item, and its place in the order of items."""

    lane: int  # number of the lane, which processes one item at a time
    wait: Callable[[], None]  # returns when all earlier items have been processed


class NewestWorker(Generic[Item]):
    """Processes items in lanes, a thread each; only the newest item waits, older ones are dropped.

    A lane takes an item only if all lanes before it are busy: the second one works only if items
    arrive faster than the first one processes them.

    process: called with each item and its turn. It must not raise.
    prepare: called in the first lane once, before the first item. It must not raise.
    niceness: added to the nice value of the threads and of those that they start, 0 to 19. Only
        Linux has nice values for threads; elsewhere it has no effect.
    lanes: most items in process at once; may be changed at any time, up to the initial number.
    skipped: number of items that a newer one replaced while they waited.
    stopping: whether `stop` was called, so that results are no longer wanted.
    """

    def __init__(
        self,
        process: Callable[[Item, Turn], None],
        prepare: Callable[[], None] = lambda: None,
        niceness: int = 0,
        lanes: int = 1,
    ) -> None:
        self.skipped = 0
        self.lanes = lanes
        self._niceness = niceness
        self._process = process
        self._prepare = prepare
        # The waiting item, if any.
        self._waiting: list[Item] = []
        self.stopping = False
        self._changed = threading.Condition()
        # Idle lanes; none before `prepare` has ended.
        self._free: set[int] = set()
        self._taken = self._done = 0
        # Daemon threads: an item that takes long must not delay the exit.
        self._threads = [
            threading.Thread(target=self._run, args=(lane,), name=f"pipeline {lane}", daemon=True)
            for lane in range(lanes)]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def offer(self, item: Item) -> None:
        """Let an item wait in place of the one that waits; return at once."""
        with self._changed:
            self.skipped += len(self._waiting)
            self._waiting = [item]
            self._changed.notify_all()

    def stop(self, timeout: float) -> bool:
        """Stop after the items in process.

        timeout: time to wait for these items, s.
        Returns whether the threads have ended.
        """
        with self._changed:
            self.stopping = True
            self._changed.notify_all()
        end = time.monotonic() + timeout
        for thread in self._threads:
            thread.join(max(end - time.monotonic(), 0.0))
        return not any(thread.is_alive() for thread in self._threads)

    def _run(self, lane: int) -> None:
        if sys.platform == "linux":
            thread = threading.get_native_id()
            own = os.getpriority(os.PRIO_PROCESS, thread)
            os.setpriority(os.PRIO_PROCESS, thread, min(own + self._niceness, 19))
        if lane == 0:
            self._prepare()
            with self._changed:
                self._free = set(range(len(self._threads)))
                self._changed.notify_all()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self.stopping or self._may_take(lane))
                if self.stopping:
                    return
                item = self._waiting.pop()
                self._free.remove(lane)
                number = self._taken
                self._taken += 1
            wait = functools.partial(self._wait, number)
            self._process(item, Turn(lane, wait))
            wait()
            with self._changed:
                self._done += 1
                self._free.add(lane)
                self._changed.notify_all()

    def _may_take(self, lane: int) -> bool:
        return bool(self._waiting) and lane < self.lanes and lane == min(self._free, default=None)

    def _wait(self, number: int) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._done == number)
