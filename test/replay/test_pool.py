# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Under lamps frames are restored with the light of those before, by any number of processes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from uw_visibility.replay import work
from uw_visibility.replay.work import FrameAnswer, FramePool, FrameTask, LightHistory
from uw_visibility.water.estimate import LampLight


def light_after(frame: int) -> LampLight:
    return LampLight(*(np.full(3, float(frame)) for _ in range(5)))


def given(lights: LightHistory) -> float | None:
    light = lights.next()
    return None if light is None else float(light.power[0])


@pytest.mark.parametrize("jobs", [1, 2, 3])
@pytest.mark.parametrize("fast", [True, False])
def test_the_light_a_frame_gets_is_that_of_a_frame_that_is_sure_to_be_answered(
    jobs: int, fast: bool
) -> None:
    """Whether all before are answered, or as few as the pool allows."""
    ahead = FramePool(jobs).read_ahead
    lights = LightHistory(ahead)
    answered = 0
    for frame in range(12):
        while answered < (frame if fast else frame - ahead):
            lights.add(light_after(answered))
            answered += 1
        expected = frame - ahead - 1
        assert given(lights) == (expected if expected >= 0 else None)


def test_one_process_gives_each_frame_the_light_of_the_last() -> None:
    assert FramePool(1).read_ahead == 0


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_what_asks_for_the_water_before_it_gets_that_of_the_frame_before(
    jobs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    worked: list[Any] = []

    def answer(task: FrameTask) -> FrameAnswer:
        worked.append(task.frame)
        return FrameAnswer((task.frame, task.known_water), asked=task.frame % 3 == 1)  # type: ignore[arg-type]

    monkeypatch.setattr(work, "answer", answer)
    answered: list[int] = []
    with ThreadPoolExecutor(jobs) as executor:
        pool = FramePool(jobs, executor if jobs > 1 else None)
        tasks = [FrameTask(None, number) for number in range(8)]  # type: ignore[arg-type]
        given = {}
        for found in pool.answers(tasks, lambda: answered[-1] if answered else None):  # type: ignore[arg-type,return-value]
            number, known = found.record
            given[number] = known
            answered.append(number)
    assert answered == list(range(8))
    assert [given[number] for number in (1, 4, 7)] == [0, 3, 6]
    assert len(worked) == (8 if jobs == 1 else 11)
