# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Lamps as parameters: places, directions, beams and colours of several."""

from __future__ import annotations

from typing import Any

import pytest

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError

TWO = {
    "lighting.model": "lamps",
    "lighting.positions": [-0.5, 0.0, 0.1, 0.5, 0.0, 0.1],
    "lighting.directions": [0.3, 0.0, 1.0, -0.3, 0.0, 1.0],
    "lighting.beam_angles": [60.0, 0.0],
    "lighting.colours": [1.0, 0.9, 0.8, 0.5, 0.5, 0.5],
}


def test_lamps_are_read_one_after_the_other_with_axes_of_length_1() -> None:
    first, second = PipelineConfig.from_parameters(TWO).lighting.lamps()
    assert first.position == (-0.5, 0.0, 0.1)
    assert first.direction == pytest.approx((0.3 / 1.09**0.5, 0.0, 1 / 1.09**0.5))
    assert (first.beam_angle, first.colour) == (60.0, (1.0, 0.9, 0.8))
    assert second.position == (0.5, 0.0, 0.1)
    # 0 is for a lamp that shines alike in all directions.
    assert (second.beam_angle, second.colour) == (360.0, (0.5, 0.5, 0.5))


def test_what_is_given_once_is_for_all_lamps() -> None:
    config = PipelineConfig.from_parameters({
        "lighting.model": "both", "lighting.positions": TWO["lighting.positions"],
        "lighting.beam_angles": [75]})
    first, second = config.lighting.lamps()
    assert first._replace(position=second.position) == second
    assert (second.direction, second.beam_angle) == ((0.0, 0.0, 1.0), 75.0)
    assert second.colour == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("positions", [0.1, 0.2], "give 3 numbers for each"),
        ("positions", [], "give 3 numbers for each"),
        ("positions", [0.1, 0.2, 21.0, 0.5, 0.0, 0.1], "between -20 and 20 m"),
        ("positions", [0.1, 0.2, float("nan"), 0.5, 0.0, 0.1], "between -20 and 20 m"),
        ("positions", [0.5, 0.0, 0.1, 0.0, 0.0, 0.0], "lamp 2"),
        ("positions", [0.5, 0.0, 0.1] * 17, "16 at most"),
        ("positions", [0.5, 0.0, 0.1], "give one for each lamp, or one for all"),
        ("directions", [0.0, 0.0, 1.0] * 3, "give one for each lamp, or one for all"),
        ("directions", [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], "has none for lamp 2"),
        ("beam_angles", [60.0] * 3, "give one for each lamp, or one for all"),
        ("beam_angles", [60.0, 361.0], "between 0 and 360 degrees"),
        ("beam_angles", [], "give 1 number for each"),
        ("colours", [1.0, 1.0, 1.0] * 3, "give one for each lamp, or one for all"),
        ("colours", [1.0, 1.0, 1.0, 0.0, 0.0, 0.0], "has none for lamp 2"),
        ("colours", [1.0, 1.0, -1.0, 1.0, 1.0, 1.0], "between 0 and 1000"),
        ("model", "night", "daylight, lamps, both"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(name: str, value: Any, told: str) -> None:
    with pytest.raises(InputError) as refused:
        PipelineConfig.from_parameters(TWO | {f"lighting.{name}": value})
    assert told in str(refused.value)
    assert "parameter lighting." in str(refused.value)


def test_lamps_need_places() -> None:
    with pytest.raises(InputError, match=r"lighting\.positions.*give x, y, z of each lamp"):
        PipelineConfig.from_parameters({"lighting.model": "lamps"})


def test_by_daylight_lamps_may_be_set_one_parameter_after_the_other() -> None:
    PipelineConfig.from_parameters({"lighting.beam_angles": [60.0] * 5})
