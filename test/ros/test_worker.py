# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The worker takes the newest item and never makes anyone wait."""

from __future__ import annotations

import os
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from uw_visibility.ros.worker import NewestWorker


class Slow:
    """A process whose items wait until they are let through."""

    def __init__(self) -> None:
        self.begun = threading.Semaphore(0)
        self.allowed = threading.Semaphore(0)
        self.seen: list[int] = []

    def __call__(self, item: int) -> None:
        self.begun.release()
        assert self.allowed.acquire(timeout=20)
        self.seen.append(item)


def test_newest_item_is_next_and_the_others_are_counted() -> None:
    slow = Slow()
    worker = NewestWorker(slow)
    worker.start()
    worker.offer(0)
    assert slow.begun.acquire(timeout=20)
    for item in range(1, 6):
        worker.offer(item)
    slow.allowed.release(2)
    assert slow.begun.acquire(timeout=20)
    assert worker.stop(20)
    assert slow.seen == [0, 5]
    assert worker.skipped == 4


def test_preparation_comes_before_the_first_item_in_the_same_thread() -> None:
    events: list[tuple[str, int]] = []
    done = threading.Event()

    def process(item: str) -> None:
        events.append((item, threading.get_ident()))
        done.set()

    worker = NewestWorker(process, lambda: events.append(("prepare", threading.get_ident())))
    worker.start()
    worker.offer("item")
    assert done.wait(20)
    assert worker.stop(20)
    assert [name for name, _ in events] == ["prepare", "item"]
    assert events[0][1] == events[1][1] != threading.get_ident()


def test_stop_does_not_wait_longer_than_told() -> None:
    slow = Slow()
    worker = NewestWorker(slow)
    worker.start()
    worker.offer(1)
    assert slow.begun.acquire(timeout=20)
    worker.offer(2)
    assert not worker.stop(0.01)
    assert worker.stopping
    slow.allowed.release(2)
    assert worker.stop(20)
    assert slow.seen == [1]


def test_no_item_is_taken_before_the_preparation_ends() -> None:
    prepared, taken = threading.Event(), threading.Event()

    def process(item: int) -> None:
        taken.set()

    worker = NewestWorker(process, lambda: prepared.wait(20) and None)
    worker.start()
    worker.offer(1)
    assert not taken.wait(0.05)
    prepared.set()
    assert taken.wait(20)
    assert worker.stop(20)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux knows priorities of threads")
def test_the_thread_gives_way_to_others_and_so_do_those_that_it_starts() -> None:
    def priority() -> int:
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    found: list[int] = []

    def process(item: int) -> None:
        found.append(priority())
        with ThreadPoolExecutor(1) as helpers:
            found.append(helpers.submit(priority).result())

    own = priority()
    worker = NewestWorker(process, niceness=3)
    worker.start()
    worker.offer(1)
    end = time.monotonic() + 20
    while len(found) < 2 and time.monotonic() < end:
        time.sleep(0.001)
    assert worker.stop(20)
    assert found == [min(own + 3, 19)] * 2
    assert priority() == own
