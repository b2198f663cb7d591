# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Process pool for frames, with their answers in order.

Only what is true of a frame alone is computed in the processes. Whatever carries
state from frame to frame runs where the answers arrive, in the order of the
recording, so the number of processes changes nothing but the time it takes.
"""

from __future__ import annotations

import signal
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import replace
from typing import TypeVar

from uw_visibility.compute.processes import process_pool
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.messages.processor import try_out, warm_up
from uw_visibility.replay.work import FrameAnswer, FrameTask, answer
from uw_visibility.water.estimate import LampLight

Other = TypeVar("Other")

# Frames that are read ahead, for each process: enough that none waits, few enough for memory.
READ_AHEAD = 2


class FramePool:
    """Pool for frames; see `frame_pool`.

    Parameters
    ----------
    jobs : int
        Processes; 1 works in this one.
    executor : Executor, optional
        Of the processes, where there are several.
    """

    def __init__(self, jobs: int, executor: Executor | None = None) -> None:
        self._jobs = jobs
        self._executor = executor

    @property
    def read_ahead(self) -> int:
        """Tasks that may be unanswered when the next one is given."""
        return 0 if self._jobs == 1 else READ_AHEAD * self._jobs

    def answers(self, items: Iterable[FrameTask | Other]) -> Iterator[FrameAnswer | Other]:
        """Yield the answers to tasks in the order of the items; hand on what is no task."""
        if self._executor is None:
            for item in items:
                yield answer(item) if isinstance(item, FrameTask) else item
            return
        waiting: deque[Future[FrameAnswer] | Other] = deque()
        tasks = 0
        for item in items:
            if isinstance(item, FrameTask):
                waiting.append(self._executor.submit(answer, item))
                tasks += 1
            else:
                waiting.append(item)
            while waiting and (
                tasks > self.read_ahead or not isinstance(waiting[0], Future)
                or waiting[0].done()
            ):
                head = waiting.popleft()
                tasks -= isinstance(head, Future)
                yield head.result() if isinstance(head, Future) else head
        for head in waiting:
            yield head.result() if isinstance(head, Future) else head


@contextmanager
def frame_pool(jobs: int, config: PipelineConfig) -> Iterator[FramePool]:
    """Open a pool of so many processes, ready for frames with a configuration."""
    # Here and once, rather than in each process or with each frame.
    try_out(config)
    if jobs == 1:
        warm_up(config)
        yield FramePool(jobs)
        return
    with process_pool(jobs, _begin, config) as executor:
        yield FramePool(jobs, executor)


def _begin(config: PipelineConfig) -> None:
    # Ctrl-C reaches every process of a terminal; the first one ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warm_up(config)


class LightHistory:
    """Light after each of the frames that are answered.

    A frame gets the light up to so many frames before it: as many as several processes may be
    at beside it, so that it does not depend on which of them is fast.

    Parameters
    ----------
    ahead : int
        Frames that may be unanswered when a task is given.
    """

    def __init__(self, ahead: int) -> None:
        self._ahead = ahead
        self._lights: deque[LampLight | None] = deque([None])
        self._given = 0

    def add(self, light: LampLight | None) -> None:
        """Take in the light after the next frame that is answered."""
        # What it was estimated from is long, and restores nothing.
        self._lights.append(None if light is None else replace(light, cells=None, ground=None))

    def next(self) -> LampLight | None:
        """Light for the next frame; None before any is known."""
        if self._given > self._ahead:
            self._lights.popleft()
        self._given += 1
        return self._lights[0]
