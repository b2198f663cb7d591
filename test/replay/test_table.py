# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The table of a replay, as a spreadsheet opens it and as it is read again."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from uw_visibility.replay.table import TableWriter, read_rows
from uw_visibility_lab.evaluation.tables import as_csv


@pytest.mark.parametrize("text", [
    '=HYPERLINK("https://here", "dive")', "+cmd|' /C calc'!A0", "@SUM(A1)", "-2+3", "\t=1+1",
    "\n=1+1", "-",
])
def test_a_name_from_outside_is_no_formula(text: str, tmp_path: Path) -> None:
    path = tmp_path / "frames.csv"
    writer = TableWriter(path, ("transect", "depth"))
    writer.write({"transect": text, "depth": "-3.5"})
    writer.close()
    with path.open(encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    assert row == {"transect": f"'{text}", "depth": "-3.5"}
    # Other products have the name as it is.
    assert list(read_rows(path)) == [{"transect": text, "depth": "-3.5"}]
    assert f"'{text[:3]}" in as_csv([{"scene": text, "depth": -3.5}]).replace('""', '"')


def test_a_carriage_return_ends_no_row(tmp_path: Path) -> None:
    path = tmp_path / "frames.csv"
    writer = TableWriter(path, ("transect", "depth"))
    writer.write({"transect": "dive\r=1+1", "depth": "1"})
    writer.write({"transect": "\r=1+1", "depth": "2"})
    writer.close()
    assert path.read_text(encoding="utf-8").split("\n")[1:3] == ["dive =1+1,1", "' =1+1,2"]
    assert [row["depth"] for row in read_rows(path)] == ["1", "2"]


@pytest.mark.parametrize("text", ["-1e-05", "+3", "\tdive", "-inf", "'tis", "a=b", ""])
def test_numbers_and_other_texts_stay_as_they_are(text: str, tmp_path: Path) -> None:
    path = tmp_path / "frames.csv"
    writer = TableWriter(path, ("transect", "depth"))
    writer.write({"transect": text, "depth": "1"})
    writer.close()
    assert path.read_text(encoding="utf-8").splitlines()[1] == f"{text},1"
    assert list(read_rows(path)) == [{"transect": text, "depth": "1"}]
