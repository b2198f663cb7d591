# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Table of the field's quantities that are derived from the estimates."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uw_visibility.replay.report.sentences import number, rounded
from uw_visibility.replay.table import read_columns, read_rows
from uw_visibility.water.derived import QUANTITIES


def derived_quantities(table: Path) -> list[dict[str, str]]:
    """Return the field's quantities, derived from the filtered water where there is one."""
    columns = read_columns(
        table, [f"{prefix}{name}{end}" for prefix in ("", "filtered_") for name in QUANTITIES
                for end in ("", "_stddev")])
    rows = []
    for name, quantity in QUANTITIES.items():
        prefix = "filtered_" if np.isfinite(columns[f"filtered_{name}"]).any() else ""
        values, stddev = columns[f"{prefix}{name}"], columns[f"{prefix}{name}_stddev"]
        known = np.isfinite(values)
        if known.any():
            low, middle, high = np.percentile(values[known], [5.0, 50.0, 95.0])
            spread = float(np.median(stddev[known]))
            unit = quantity.unit.replace("m-1", "1/m")
            rows.append({
                "title": quantity.title, "median": f"{rounded(middle, spread)} {unit}",
                "span": f"{number(low)} to {number(high)} {unit}",
                "definition": quantity.definition, "caveat": quantity.caveat,
                "source": quantity.source,
            })
    return rows + _water_type(table)


def _water_type(table: Path) -> list[dict[str, str]]:
    """Return the Jerlov type that most frames are nearest to, with its likelihood in those."""
    likelihoods: dict[str, dict[str, list[float]]] = {"": {}, "filtered_": {}}
    for row in read_rows(table):
        for prefix, by_type in likelihoods.items():
            name, share = row[f"{prefix}water_type"], row[f"{prefix}water_type_likelihood"]
            if name:
                by_type.setdefault(name, []).append(float(share))
    by_type = likelihoods["filtered_"] or likelihoods[""]
    if not by_type:
        return []
    most = max(by_type, key=lambda name: len(by_type[name]))
    others = [f"{name} ({len(found)})" for name, found in sorted(by_type.items())]
    return [{
        "title": "nearest Jerlov type",
        "median": f"{most}, likelihood {np.median(by_type[most]):.2f}",
        "span": f"frames: {', '.join(others)}",
        "definition": "Water type whose beam attenuation, as this camera sees it, is the likeliest",
        "caveat": "Types are defined by Kd; particles shift them by a type or more.",
        "source": "Williamson and Hollins 2022, doi:10.1364/AO.470464; Solonenko and Mobley 2015, "
        "doi:10.1364/AO.54.005392",
    }]
