# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Phase functions against what is published of them, and as the tracer's tables."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import trapezoid

from uw_visibility.errors import InputError
from uw_visibility_lab.tracer.phase import FOURNIER_FORAND, PETZOLD, cosine_table, petzold


def test_petzolds_average_has_its_published_mean_cosine_and_backscatter() -> None:
    angle = np.concatenate([np.geomspace(1e-6, 1e-3, 2000)[:-1], np.geomspace(1e-3, np.pi, 50000)])
    weight = 2.0 * np.pi * petzold(angle) * np.sin(angle)
    whole = trapezoid(weight, angle)
    assert whole == pytest.approx(1.0, abs=0.015)
    assert trapezoid(weight * np.cos(angle), angle) / whole == pytest.approx(0.924, abs=0.002)
    back = trapezoid(np.where(angle > np.pi / 2.0, weight, 0.0), angle) / whole
    assert back == pytest.approx(0.0183, abs=0.0002)


@pytest.mark.parametrize(("phase", "cosine"), [(PETZOLD, 0.924), (FOURNIER_FORAND, 0.930)])
def test_a_table_integrates_to_one_and_keeps_the_mean_cosine(phase: str, cosine: float) -> None:
    table = cosine_table(phase, 1 << 15)
    step = 2.0 / (len(table) - 1)
    whole = 2.0 * math.pi * step * (table.sum() - 0.5 * (table[0] + table[-1]))
    assert whole == pytest.approx(1.0, abs=0.01)
    along = np.linspace(-1.0, 1.0, len(table))
    mean = trapezoid(table * along, along) / trapezoid(table, along)
    assert mean == pytest.approx(cosine, abs=0.005)


def test_a_phase_function_without_a_table_is_refused() -> None:
    with pytest.raises(InputError, match="rayleigh"):
        cosine_table("rayleigh")
