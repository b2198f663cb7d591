# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Text from outside, as it is shown."""

from __future__ import annotations

import pickle

import pytest

from uw_visibility.errors import LONGEST_MESSAGE, InputError, printable


@pytest.mark.parametrize("text", [
    "\x1b[2Jcleared", "a\r\nforged line", "bell\a", "right\u202eto left", "nothing\0", "\ud800",
])
def test_control_characters_are_not_shown(text: str) -> None:
    shown = printable(text)
    assert shown.isprintable() and len(shown) == len(text)
    assert str(InputError(text)) == shown


def test_long_texts_keep_both_ends() -> None:
    shown = printable("/bags/" + "x" * 10_000 + "/dive.mcap", 50)
    assert len(shown) == 50
    assert shown.startswith("/bags/") and shown.endswith("/dive.mcap")
    assert len(str(InputError("y" * 10_000_000))) == LONGEST_MESSAGE


def test_names_of_any_script_are_left_as_they_are() -> None:
    assert printable("/Ångström/深さ °C") == "/Ångström/深さ °C"


def test_an_error_of_another_process_says_the_same() -> None:
    error = InputError("parameter x is 3: give 1 or 2")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
