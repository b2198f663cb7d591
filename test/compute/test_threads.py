# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Bands of rows: each row once, whatever the threads, and no error lost."""

import os
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uw_visibility.compute.threads import Workers, number_of_threads

POOLS = {threads: Workers(threads) for threads in (1, 2, 5)}


@given(st.sampled_from(sorted(POOLS)), st.integers(1, 200))
def test_every_row_is_worked_on_once(threads, count):
    seen = np.zeros(count, int)

    def kernel(start, stop, out):
        out[start:stop] += 1

    POOLS[threads].rows(kernel, count, seen)
    assert (seen == 1).all()


def test_rows_are_shared_by_threads():
    barrier = threading.Barrier(2, timeout=10)
    names = set()

    def kernel(start, _stop):
        if start == 0 or (len(names) < 2 and threading.get_ident() not in names):
            names.add(threading.get_ident())
            barrier.wait()

    POOLS[2].rows(kernel, 60)
    assert len(names) == 2


@pytest.mark.parametrize("threads", sorted(POOLS))
def test_an_error_in_a_band_reaches_the_caller_and_the_pool_lives_on(threads):
    def kernel(start, _stop):
        raise ValueError(f"row {start}")

    with pytest.raises(ValueError, match="row"):
        POOLS[threads].rows(kernel, 10)
    done = np.zeros(10, int)
    POOLS[threads].rows(lambda a, b: done.__setitem__(slice(a, b), 1), 10)
    assert done.all()


def test_callers_in_several_threads_do_not_disturb_one_another():
    sums = {}

    def caller(seed):
        out = np.zeros(101, int)
        for _ in range(50):
            POOLS[2].rows(lambda a, b: out.__setitem__(slice(a, b), out[a:b] + seed), 101)
        sums[seed] = out

    callers = [threading.Thread(target=caller, args=(seed,)) for seed in (1, 2, 3)]
    for thread in callers:
        thread.start()
    for thread in callers:
        thread.join()
    assert all((sums[seed] == 50 * seed).all() for seed in (1, 2, 3))


@pytest.mark.parametrize("threads", sorted(POOLS))
def test_two_calls_together_return_both_results_and_may_share_rows(threads):
    pool = POOLS[threads]

    def count():
        seen = np.zeros(90, int)
        pool.rows(lambda a, b: seen.__setitem__(slice(a, b), seen[a:b] + 1), 90)
        return seen

    for _ in range(20):
        first, second = pool.together(count, lambda: (count(), "second"))
        assert (first == 1).all() and (second[0] == 1).all() and second[1] == "second"


def test_two_calls_together_run_at_once():
    barrier = threading.Barrier(2, timeout=10)
    POOLS[2].together(barrier.wait, barrier.wait)


@pytest.mark.parametrize("threads", sorted(POOLS))
@pytest.mark.parametrize("failing", [0, 1])
def test_an_error_of_either_call_reaches_the_caller(threads, failing):
    def fail():
        raise ValueError("broken")

    calls = [lambda: 1, lambda: 2]
    calls[failing] = fail
    with pytest.raises(ValueError, match="broken"):
        POOLS[threads].together(*calls)
    assert POOLS[threads].together(lambda: 1, lambda: 2) == (1, 2)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="not Linux")
def test_processors_that_the_process_may_not_use_get_no_thread():
    before = os.sched_getaffinity(0)
    assert number_of_threads(0) == len(before)
    try:
        os.sched_setaffinity(0, {min(before)})
        assert (number_of_threads(0), number_of_threads(3)) == (1, 3)
    finally:
        os.sched_setaffinity(0, before)
