# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""YAML and JSON that no honest tool writes, and what honest ones do write."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uw_visibility.config.documents import parse_json, parse_yaml, read_document
from uw_visibility.errors import InputError

LAUGHS = "a: &a [x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(("text", "reason"), [
    (LAUGHS, "refers to another part"),
    ("a: &a [*a]", "refers to another part"),
    ("[" * 100_000, "deeper"),
    ("a:\n" + "".join(" " * k + "b:\n" for k in range(1, 100)), "deeper"),
    ("? " * 10_000, "deeper"),
    ("{a: 1, b: {c: 1, c: 2}}", "'c' twice"),
    ("9" * 5000, "number of 5000 characters"),
    ("0x" + "f" * 50, "64 bit"),
    ("1" + ":59" * 10_000, "characters"),
    ("2024-99-99", "type"),
    ("!!int ''", "type"),
    ("!!python/object/apply:os.system ['true']", "tag"),
    ("a: b: c", "mapping"),
    ("\x01", "characters"),
])
def test_yaml_that_no_tool_writes_is_refused(text: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        parse_yaml(text)


@pytest.mark.parametrize(("text", "reason"), [
    ("[" * 100_000, "nested too deep"),
    ('{"a": 1, "a": 2}', "'a' twice"),
    ("9" * 5000, "number of 5000 characters"),
    ("1" * 50, "64 bit"),
    ('{"P1": NaN}', "NaN"),
    ("{", "Expecting"),
])
def test_json_that_no_tool_writes_is_refused(text: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        parse_json(text)


def test_what_tools_write_is_read() -> None:
    assert parse_yaml("a: {b: [1, 2.5, -3.0e-2, true, null, 'x']}\n? c\n: 0x1F\n") == {
        "a": {"b": [1, 2.5, -0.03, True, None, "x"]}, "c": 31,
    }
    assert parse_json('{"P1": [[1, 0.5], [-1e3, 0]], "width": 640}') == {
        "P1": [[1, 0.5], [-1e3, 0]], "width": 640,
    }


@given(st.text(max_size=200) | st.text("[]{}&*!|>?:-, \n\"'#%@`ab01", max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    for parse in (parse_yaml, parse_json):
        try:
            parse(text)
        except InputError as error:
            assert str(error)


def test_the_file_is_named(tmp_path: Path) -> None:
    for name, content in (("a.yaml", b"a: [" * 100), ("a.json", b"{"), ("b.yaml", b"\xff\xfe\xff")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=f"calibration .*{name} is not"):
            read_document(tmp_path / name, "calibration")
    with (tmp_path / "large.yaml").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match="larger"):
        read_document(tmp_path / "large.yaml", "calibration")
