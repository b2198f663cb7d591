# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Tables on the terminal, in JSON and as CSV."""

from __future__ import annotations

import json
import math
from pathlib import Path

from uw_visibility_lab.evaluation.readings import Truth
from uw_visibility_lab.evaluation.tables import as_text, flat, grouped, number, write_report


def test_columns_are_as_wide_as_their_widest_cell() -> None:
    text = as_text(["water", "α", "d"], [["a", "0.1", ""], ["turbid", "0.25", "3"]])
    assert text.splitlines() == [
        "water        α  d",
        "  a        0.1",
        "  turbid  0.25  3",
    ]


def test_what_is_not_known_is_a_dash_an_empty_field_and_null(tmp_path: Path) -> None:
    assert (number(math.nan, 2), number(0.125, 1)) == ("–", "0.1")
    rows = [{"name": "=1", "value": math.inf}]
    write_report(tmp_path, {"rows": rows, "none": []}, {"rows": rows})
    assert (tmp_path / "rows.csv").read_text() == "name,value\n'=1,\n"
    assert not (tmp_path / "none.csv").exists()
    assert json.loads((tmp_path / "evaluation.json").read_text())["rows"][0]["value"] is None


def test_a_row_names_records_by_field_and_channels_by_colour() -> None:
    truth = Truth(0.1, 3.0, (0.3, 0.2, 0.1), (0.5, 0.5, 0.5), 8.0)
    row = flat({"scene": "reef", "true": truth, "shares": {"ours": 0.5}})
    assert row["true.attenuation.green"] == 0.2
    assert (row["scene"], row["true.depth"], row["shares.ours"]) == ("reef", 3.0, 0.5)


def test_groups_are_in_the_order_of_their_first():
    assert grouped([3, 1, 2, 5, 4], lambda n: n % 2) == {1: [3, 1, 5], 0: [2, 4]}
