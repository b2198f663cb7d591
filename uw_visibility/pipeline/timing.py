# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Timing of the stages of a frame."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class StageClock:
    """Durations of the stages of one frame; called with a stage's name, it times a block."""

    def __init__(self) -> None:
        self._begin = time.perf_counter()
        self._stages: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self._stages[stage] = 1e3 * (time.perf_counter() - begin)

    def milliseconds(self) -> dict[str, float]:
        """Return the stages and ``total``."""
        return {**self._stages, "total": 1e3 * (time.perf_counter() - self._begin)}
