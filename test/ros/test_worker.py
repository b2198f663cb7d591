# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The worker takes the newest item and never makes anyone wait."""

from __future__ import annotations

import os
import queue
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from uw_visibility.ros.worker import NewestWorker, Turn


class Slow:
    """A process whose items wait until they are let through."""

    def __init__(self) -> None:
        self.begun = threading.Semaphore(0)
        self.allowed = threading.Semaphore(0)
        self.seen: list[int] = []

    def __call__(self, item: int, turn: Turn) -> None:
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

    def process(item: str, turn: Turn) -> None:
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

    def process(item: int, turn: Turn) -> None:
        taken.set()

    worker = NewestWorker(process, lambda: prepared.wait(20) and None)
    worker.start()
    worker.offer(1)
    assert not taken.wait(0.05)
    prepared.set()
    assert taken.wait(20)
    assert worker.stop(20)


def test_a_second_lane_takes_what_waits_and_results_keep_the_order_of_the_items() -> None:
    allowed = {item: threading.Event() for item in range(4)}
    begun: queue.Queue[tuple[int, int]] = queue.Queue()
    told: queue.Queue[int] = queue.Queue()

    def process(item: int, turn: Turn) -> None:
        begun.put((item, turn.lane))
        assert allowed[item].wait(20)
        turn.wait()
        told.put(item)

    worker = NewestWorker(process, lanes=2)
    worker.start()
    for item in (0, 1):
        worker.offer(item)
        assert begun.get(timeout=20) == (item, item)
    # Both lanes are busy: of what comes now the newest waits.
    worker.offer(2)
    worker.offer(3)
    assert worker.skipped == 1
    # The second item ends first, and is told after the first all the same.
    allowed[1].set()
    allowed[3].set()
    with pytest.raises(queue.Empty):
        told.get(timeout=0.05)
    allowed[0].set()
    assert [told.get(timeout=20) for _ in range(3)] == [0, 1, 3]
    assert worker.stop(20)


def test_the_second_lane_takes_nothing_while_the_first_is_free_or_lanes_are_lowered() -> None:
    seen: queue.Queue[tuple[int, int]] = queue.Queue()
    first = threading.Event()

    def process(item: int, turn: Turn) -> None:
        worker.lanes = 1
        seen.put((item, turn.lane))
        assert item or first.wait(20)

    worker = NewestWorker(process, lanes=2)
    worker.start()
    worker.offer(0)
    assert seen.get(timeout=20) == (0, 0)
    worker.offer(1)
    with pytest.raises(queue.Empty):
        seen.get(timeout=0.05)
    first.set()
    assert seen.get(timeout=20) == (1, 0)
    assert worker.stop(20)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux knows priorities of threads")
def test_the_thread_gives_way_to_others_and_so_do_those_that_it_starts() -> None:
    def priority() -> int:
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    found: list[int] = []

    def process(item: int, turn: Turn) -> None:
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
