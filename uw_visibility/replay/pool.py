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
from contextlib import ExitStack
from types import TracebackType
from typing import TypeVar

from uw_visibility.compute.processes import process_pool
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.messages.processor import try_out, warm_up
from uw_visibility.replay.work import FrameAnswer, FrameTask, answer

Other = TypeVar("Other")

# Frames that are read ahead, for each process: enough that none waits, few enough for memory.
READ_AHEAD = 2


class FramePool:
    """Process pool for frames; to be used in a ``with`` statement.

    Parameters
    ----------
    jobs : int
        Processes; 1 works in this one.
    config : PipelineConfig
        What to get ready for.
    """

    def __init__(self, jobs: int, config: PipelineConfig) -> None:
        self.jobs = jobs
        self._config = config
        self._pool: Executor | None = None
        self._open = ExitStack()

    @property
    def read_ahead(self) -> int:
        """Tasks that may be unanswered when the next one is given."""
        return 0 if self.jobs == 1 else READ_AHEAD * self.jobs

    def answers(self, items: Iterable[FrameTask | Other]) -> Iterator[FrameAnswer | Other]:
        """Yield the answers to tasks in the order of the items; hand on what is no task."""
        if self._pool is None:
            for item in items:
                yield answer(item) if isinstance(item, FrameTask) else item
            return
        waiting: deque[Future[FrameAnswer] | Other] = deque()
        tasks = 0
        for item in items:
            if isinstance(item, FrameTask):
                waiting.append(self._pool.submit(answer, item))
                tasks += 1
            else:
                waiting.append(item)
            while waiting and (
                tasks > READ_AHEAD * self.jobs or not isinstance(waiting[0], Future)
                or waiting[0].done()
            ):
                head = waiting.popleft()
                tasks -= isinstance(head, Future)
                yield head.result() if isinstance(head, Future) else head
        for head in waiting:
            yield head.result() if isinstance(head, Future) else head

    def __enter__(self) -> FramePool:
        # Here and once, rather than in each process or with each frame.
        try_out(self._config)
        if self.jobs == 1:
            warm_up(self._config)
        else:
            self._pool = self._open.enter_context(process_pool(self.jobs, _begin, self._config))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # Which says what the end of a process means.
        self._open.__exit__(kind, error, trace)


def _begin(config: PipelineConfig) -> None:
    # Ctrl-C reaches every process of a terminal; the first one ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warm_up(config)
