# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Ratios of attenuation to beam attenuation over traced scenes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.tracer.files import Traced
from uw_visibility_lab.tracer.summary import complete, ratios, table


def scene(attenuation: float) -> Traced:
    """Return a scene of c 0.4 and b 0.2 1/m without images."""
    empty, nothing = np.zeros((1, 1, 3)), np.full(3, np.nan)
    return Traced(
        "reef", 1, empty, empty[..., 0], np.full(3, attenuation), nothing, np.full(3, 0.4), nothing,
        np.full(3, 0.2), np.full(3, 0.4), np.full(3, 0.2), np.full(3, 0.2), nothing, nothing,
        empty, empty, empty, 100.0, 0.1, {"description": {"water": {"phase": "petzold"}}})


def test_a_ratio_of_one_keeps_nothing_and_absorption_alone_keeps_all() -> None:
    ratio, kept = ratios([scene(0.4), scene(0.2)], "attenuation")
    assert ratio[:, 0] == pytest.approx([1.0, 0.5])
    assert kept[:, 0] == pytest.approx([0.0, 1.0])


def test_the_table_has_medians_by_phase_function() -> None:
    other = replace(scene(0.3), truth={"description": {"water": {"phase": "fournier-forand"}}})
    lines = table([scene(0.4), scene(0.3), scene(0.2), other])
    assert "| petzold | 3 | attenuation | 0.75 (0.50 to 1.00) | 0.50 (0.00 to 1.00) |" in lines
    assert any(line.startswith("| fournier-forand | 1 | attenuation | 0.75") for line in lines)


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="uw_visibility render"):
        complete(tmp_path)
