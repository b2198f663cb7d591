# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Described parameters: names, types, bounds."""

from __future__ import annotations

import array
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uw_visibility.config.parameters import (
    build,
    check_names,
    describe,
    flatten,
    parameter,
    section,
)
from uw_visibility.errors import InputError


@dataclass(frozen=True)
class Inner:
    """A section."""

    gain: float = parameter(2.0, "A gain.", unit="m", minimum=0.5, maximum=4.0)
    mode: str = parameter("a", "A mode.", choices=("a", "b"))


@dataclass(frozen=True)
class Outer:
    """A group."""

    count: int = parameter(3, "A count.", minimum=0)
    on: bool = parameter(False, "A switch.")
    white: tuple[float, float, float] = parameter((1.0, 1.0, 1.0), "A colour.", minimum=0.0)
    inner: Inner = section(Inner)


def test_describe_names_every_parameter_by_its_section() -> None:
    infos = {info.name: info for info in describe(Outer)}
    assert list(infos) == ["count", "on", "white", "inner.gain", "inner.mode"]
    assert infos["inner.gain"].type is float
    assert infos["inner.gain"].unit == "m"
    assert infos["inner.mode"].choices == ("a", "b")


def test_build_takes_what_is_given_and_keeps_the_rest() -> None:
    made = build(Outer, {"inner.gain": 3, "white": [1, 2, 3]})
    assert made == Outer(white=(1.0, 2.0, 3.0), inner=Inner(gain=3.0))
    assert isinstance(made.inner.gain, float)


def test_numbers_that_yaml_takes_for_texts_are_numbers() -> None:
    """YAML 1.1 asks for a point in 1.0e-05."""
    assert build(Outer, {"inner.gain": "1e+00"}).inner.gain == 1.0
    for white in ("[1e-05, 0.5, 1.0]", ["1e-05", 0.5, 1.0], ["1e-05", "5e-1", "1e+0"]):
        assert build(Outer, {"white": white}).white == (1e-05, 0.5, 1.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("count", 1.0), ("count", "1"), ("count", True), ("count", -1), ("count", None),
        ("on", 1), ("on", "false"), ("inner.gain", 0.49), ("inner.gain", 4.1),
        ("inner.gain", float("nan")), ("inner.gain", float("inf")), ("inner.gain", True),
        ("inner.gain", "two"), ("inner.gain", "nan"), ("inner.mode", "c"), ("inner.mode", 1),
        ("white", [1.0, 1.0]),
        ("white", [1.0, 1.0, "one"]), ("white", "abc"), ("white", 1.0),
        ("white", [1.0, 1.0, -0.1]), ("white", [True, True, True]),
        ("white", [1.0, 1.0, float("nan")]),
    ],
)
def test_what_does_not_fit_is_refused_by_name(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"parameter {name} is "):
        build(Outer, {name: value})


def test_numbers_of_rclpy_are_shown_as_a_list() -> None:
    with pytest.raises(InputError, match=r"parameter white is \[1\.0, 2\.0\]: give 3 numbers"):
        build(Outer, {"white": array.array("d", [1.0, 2.0])})


@pytest.mark.parametrize(
    ("wrong", "right"),
    [("inner.gian", "inner.gain"), ("cuont", "count"), ("gain", "inner.gain"), ("inner", "inner.")],
)
def test_an_unknown_name_is_refused_with_the_nearest_one(wrong: str, right: str) -> None:
    with pytest.raises(InputError, match=f"unknown parameter {wrong}: did you mean {right}"):
        check_names([wrong], [info.name for info in describe(Outer)])


@given(
    count=st.integers(0, 1000), on=st.booleans(), gain=st.floats(0.5, 4.0),
    mode=st.sampled_from(["a", "b"]),
    white=st.tuples(*[st.floats(0.0, 10.0)] * 3),
)
def test_flatten_undoes_build(
    count: int, on: bool, gain: float, mode: str, white: tuple[float, float, float]
) -> None:
    values = {"count": count, "on": on, "white": white, "inner.gain": gain, "inner.mode": mode}
    assert flatten(build(Outer, values)) == values
