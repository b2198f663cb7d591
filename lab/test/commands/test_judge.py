# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`judge` and `train`: a table for scenes, and sentences for what cannot be judged or trained."""

from __future__ import annotations

import csv
from importlib import resources
from pathlib import Path

import pytest

from uw_visibility.cli import main
from uw_visibility.water.daylight.network import WEIGHTS
from uw_visibility_lab.worlds.scenes import make_pool


def test_the_table_has_its_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_pool(2, 1, tmp_path / "pool", size=(96, 128))
    out = tmp_path / "cases.csv"
    assert main([
        "judge", "--scenes", str(tmp_path / "pool"), "--cases", "2", "--estimator", "free",
        "plain", "sea-thru", "--csv", str(out)]) == 0
    first, *rows = capsys.readouterr().out.splitlines()
    assert first.split()[:3] == ["cases", "n", "told"]
    assert [row[:24].strip() for row in rows] == [
        "scenes, no effect", "plain", "sea-thru",
        "scenes, all effects", "", "plain", "", "sea-thru", ""]
    assert {row.split()[-14] for row in rows if row[:24].strip()} == {"2"}
    assert "flip between told and not told" in rows[4]
    with out.open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [row["estimator"] for row in table[:4]] == ["free", "free", "plain", "plain"]
    # The same views for each.
    truths = [row["true.distance"] for row in table if row["cases"] == "scenes, no effect"]
    assert len(set(truths)) == 2 and float(truths[0]) > 0.0


@pytest.mark.parametrize(("arguments", "sentence"), [
    ([], "nothing to judge by"),
    (["--scenes", "{}/no"], "no"),
    (["--middlebury", "{}"], "holds no scenes"),
    (["--traced", "{}"], "no traced scenes"),
    (["--pictures"], "no pictures"),
    (["--lamps"], "no scenes for lamps"),
    (["--pictures", "--pairs", "{}"], "no pairs"),
    (["--sea", "{}"], "no frames"),
    (["--sea", "{}", "--estimator", "{}/no.npz"], "no trained networks"),
    (["--sea", "{}", "--cases", "0"], "--cases"),
    (["--sea", "{}", "--seed", "-1"], "--seed"),
    (["--scenes", "{}", "--csv", "{}"], "exists already"),
    (["--scenes", "{}", "--csv", "{}/no/cases.csv"], "the folder of --csv"),
    (["--sea", "{}", "--csv", "{}/cases.csv"], "leave it out"),
    (["--pictures", "--traced", "{}", "--csv", "{}/cases.csv"], "leave it out"),
])
def test_what_cannot_be_judged_is_one_sentence(
    arguments: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["judge", *(a.format(tmp_path) for a in arguments)]) == 2
    said = capsys.readouterr()
    (line,) = said.err.splitlines()
    assert sentence in line
    # No head of a table that does not follow.
    assert said.out == ""


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


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """Return a folder with a scene, statistics of views, networks, and a file of somebody else."""
    make_pool(1, 1, tmp_path / "pool", size=(60, 80))
    (tmp_path / "views.npz").write_bytes(b"views")
    (tmp_path / "link.npz").symlink_to(tmp_path / "pool" / "000000.npz")
    trained = resources.files("uw_visibility.data") / WEIGHTS
    (tmp_path / "networks.npz").write_bytes(trained.read_bytes())
    (tmp_path / "mine.npz").write_text("mine")
    return tmp_path


@pytest.mark.parametrize(("name", "sentence"), [
    ("pool/000000.npz", "would replace the input"),
    ("link.npz", "would replace the input"),
    ("views.npz", "would replace the input"),
    ("mine.npz", "holds no trained networks"),
    ("pool", "would replace the input"),
])
def test_nothing_but_networks_is_replaced(
    name: str, sentence: str, kept: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # What is not refused ends here, before hours of training.
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    before = {path: path.read_bytes() for path in kept.rglob("*.npz")}
    given = ["train", str(kept / "pool"), "--views-file", str(kept / "views.npz"), "--force"]
    assert main([*given, "-o", str(kept / name)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert sentence in line and f"{kept / name}" in line
    assert {path: path.read_bytes() for path in kept.rglob("*.npz")} == before


def test_statistics_that_are_not_there_yet_have_a_file_of_their_own(
    kept: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    new = str(kept / "new.npz")
    assert main(["train", str(kept / "pool"), "--views-file", new, "-o", new]) == 2
    assert "would replace the input" in capsys.readouterr().err


def test_networks_that_are_there_are_replaced_by_force_only(
    kept: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    given = ["train", str(kept / "pool"), "-o", str(kept / "networks.npz")]
    assert main(given) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*given, "--force"]) == 2
    assert "needs PyTorch" in capsys.readouterr().err


@pytest.mark.long
def test_nights_by_lamps_have_their_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_pool(2, 1, tmp_path / "pool", size=(96, 128))
    assert main([
        "judge", "--lamps", "--scenes", str(tmp_path / "pool"), "--cases", "1"]) == 0
    _, *rows = capsys.readouterr().out.splitlines()
    assert [row[:24].strip() for row in rows[:4]] == [
        "lamps, no effect", "lamps, random effects", "lamps, even ground",
        "daylight 0 beside"]
    assert rows[-2].startswith("lamps, rendered reefs")
    assert rows[-1].startswith("told as daylight")
