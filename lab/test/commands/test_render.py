# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Options of `uw_visibility render`, with and without a path tracer."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.commands import render
from uw_visibility_lab.tracer import engine


def given(tmp_path: Path, *options: str) -> argparse.Namespace:
    """Return the parsed options."""
    parser = argparse.ArgumentParser()
    render.add_options(parser)
    return parser.parse_args(["-o", str(tmp_path / "out"), *options])


@pytest.mark.parametrize(("options", "named"), [
    (["--size", "big"], "--size is big"),
    (["--size", "8x8"], "--size"),
    (["--scenes", "0"], "--scenes"),
    (["--samples", "0"], "--samples"),
    (["--kinds", "wreck"], "wreck"),
    (["--kinds", ","], "no kind"),
])
def test_a_bad_option_is_named_before_anything_is_made(
    tmp_path: Path, options: list[str], named: str,
) -> None:
    with pytest.raises(InputError, match=named):
        render.run(given(tmp_path, *options))
    assert not (tmp_path / "out").exists()


def test_a_missing_tracer_is_one_sentence_that_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    engine.mitsuba.cache_clear()
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    monkeypatch.setitem(sys.modules, "drjit", None)
    with pytest.raises(InputError, match="extra trace"):
        render.run(given(tmp_path))
    assert not (tmp_path / "out").exists()
