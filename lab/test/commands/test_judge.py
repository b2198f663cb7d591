# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`judge` and `train`: a table for scenes, and sentences for what cannot be judged or trained."""

from __future__ import annotations

from pathlib import Path

import pytest

from uw_visibility.cli import main
from uw_visibility_lab.worlds.scenes import make_pool


def test_the_table_has_its_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_pool(2, 1, tmp_path / "pool", size=(96, 128))
    assert main(["judge", "--scenes", str(tmp_path / "pool"), "--cases", "2"]) == 0
    first, *rows = capsys.readouterr().out.splitlines()
    assert first.split()[:3] == ["cases", "n", "told"]
    assert [row.rpartition(",")[0] for row in rows[:1]] == ["scenes"]
    assert rows[0].split()[3] == "2" == rows[1].split()[3]
    assert "told or not changes in" in rows[2]


@pytest.mark.parametrize(("arguments", "sentence"), [
    ([], "nothing to judge by"),
    (["--scenes", "{}/no"], "no"),
    (["--traced", "{}"], "no traced scenes"),
    (["--sea", "{}"], "no frames"),
    (["--sea", "{}", "--estimator", "{}/no.npz"], "no trained networks"),
    (["--sea", "{}", "--cases", "0"], "--cases"),
])
def test_what_cannot_be_judged_is_one_sentence(
    arguments: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["judge", *(a.format(tmp_path) for a in arguments)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert sentence in line


@pytest.mark.parametrize(("arguments", "sentence"), [
    (["--views", "3"], "--views"),
    (["--epochs", "nan"], "--epochs"),
    (["--jobs", "0"], "--jobs"),
])
def test_what_cannot_be_trained_is_one_sentence(
    arguments: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = str(tmp_path / "weights.npz")
    assert main(["train", str(tmp_path), "-o", output, *arguments]) == 2
    assert sentence in capsys.readouterr().err


def test_networks_that_are_there_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "weights.npz"
    output.write_text("mine")
    assert main(["train", str(tmp_path), "-o", str(output)]) == 2
    assert "--force" in capsys.readouterr().err and output.read_text() == "mine"
