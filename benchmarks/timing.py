# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Times of calls that take turns, and of a process."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any


def take_turns(
    candidates: Mapping[str, Callable[[], Any]], rounds: int,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, list[float]]:
    """Time every candidate once per round, after a warm-up round that does not count; ms."""
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for turn in range(rounds + 1):
        for name, call in candidates.items():
            begin = clock()
            call()
            if turn:
                times[name].append(1e3 * (clock() - begin))
    return times


def processor_time(pid: int) -> float:
    """Return the processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))
