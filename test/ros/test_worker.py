# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The worker takes the newest item and never makes anyone wait."""

from __future__ import annotations

import itertools
import os
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest

from uw_visibility.ros.worker import NewestWorker


class Slow:
    """A process whose items wait until they are let through."""

    def __init__(self) -> None:
        self.begun = threading.Semaphore(0)
        self.allowed = threading.Semaphore(0)
        self.seen: list[int] = []

    def __call__(self, item: int) -> Iterator[None]:
        yield
        self.begun.release()
        assert self.allowed.acquire(timeout=20)
        yield
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

    def process(item: str) -> Iterator[None]:
        events.append((item, threading.get_ident()))
        yield from ()
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


def test_two_items_are_worked_on_at_once_and_finished_in_their_order() -> None:
    begun = [threading.Event() for _ in range(3)]
    allowed = [threading.Event() for _ in range(3)]
    events: list[tuple[str, int]] = []

    def process(item: int) -> Iterator[None]:
        events.append(("read", item))
        yield
        begun[item].set()
        assert allowed[item].wait(20)
        events.append(("worked", item))
        yield
        events.append(("answered", item))

    worker = NewestWorker(process, threads=2)
    worker.start()
    worker.offer(0)
    assert begun[0].wait(20)
    worker.offer(1)
    assert begun[1].wait(20), "the second waits for the first"
    worker.offer(2)
    # The later one is done first, and waits: no third one begins.
    allowed[1].set()
    assert not begun[2].wait(0.05)
    assert ("answered", 1) not in events
    allowed[0].set()
    assert begun[2].wait(20)
    allowed[2].set()
    assert worker.stop(20)
    assert [item for what, item in events if what == "read"] == [0, 1, 2]
    answered = [item for what, item in events if what == "answered"]
    assert answered == [0, 1, 2]
    assert worker.skipped == 0


def test_an_item_that_is_not_to_be_processed_holds_up_no_other() -> None:
    seen = threading.Semaphore(0)

    def process(item: int) -> Iterator[None]:
        if item % 2:
            return
        yield
        yield
        seen.release()

    worker = NewestWorker(process, threads=2)
    worker.start()
    for item in range(6):
        worker.offer(item)
        if item % 2 == 0:
            assert seen.acquire(timeout=20)
        else:
            while worker._items:
                pass
    assert worker.stop(20)


def test_no_thread_takes_an_item_before_the_preparation_ends() -> None:
    prepared, taken = threading.Event(), threading.Event()

    def process(item: int) -> Iterator[None]:
        taken.set()
        yield

    worker = NewestWorker(process, lambda: prepared.wait(20) and None, threads=3)
    worker.start()
    worker.offer(1)
    assert not taken.wait(0.05)
    prepared.set()
    assert taken.wait(20)
    assert worker.stop(20)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux knows priorities of threads")
def test_threads_give_way_to_others_and_so_do_those_that_they_start() -> None:
    def priority() -> int:
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    found: list[int] = []

    def process(item: int) -> Iterator[None]:
        found.append(priority())
        with ThreadPoolExecutor(1) as helpers:
            found.append(helpers.submit(priority).result())
        yield

    own = priority()
    worker = NewestWorker(process, threads=2, niceness=3)
    worker.start()
    worker.offer(1)
    while len(found) < 2:
        time.sleep(0.001)
    assert worker.stop(20)
    assert found == [min(own + 3, 19)] * 2
    assert priority() == own


@pytest.mark.parametrize(
    ("period", "answered"),
    [
        # A burst: two frames wait for two threads.
        (0.001, [0, 1, 5, 6]),
        # One after the other: what is overtaken by a newer one is old.
        (0.03, [0, 1, 6]),
    ],
)
def test_items_that_come_together_wait_together_and_others_give_way_to_newer_ones(
    period: float, answered: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = itertools.count(1)
    monkeypatch.setattr(
        "uw_visibility.ros.worker.time", SimpleNamespace(monotonic=lambda: period * next(clock))
    )
    slow = Slow()
    worker = NewestWorker(slow, threads=2)
    worker.start()
    for item in range(2):
        worker.offer(item)
        assert slow.begun.acquire(timeout=20)
    for item in range(2, 7):
        worker.offer(item)
    slow.allowed.release(7)
    while len(slow.seen) < len(answered):
        time.sleep(0.001)
    assert worker.stop(20)
    assert slow.seen == answered
    assert worker.skipped == 7 - len(answered)
