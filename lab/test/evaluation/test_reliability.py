# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reliability of confidence, on disparities whose errors are drawn."""

import numpy as np
import pytest

from uw_visibility_lab.evaluation.metrics import expected_error, reliability, reliability_rows

SHAPE = (200, 300)


def drawn(overstated: float = 0.0) -> np.ndarray:
    """Count disparities that are right as often as confidence says, less what it overstates."""
    rng = np.random.default_rng(3)
    confidence = rng.uniform(0.3, 1.0, SHAPE).astype(np.float32)
    wrong = rng.uniform(size=SHAPE) > confidence - overstated
    truth = np.full(SHAPE, 20.0, np.float32)
    disparity = np.where(wrong, truth + 5, truth + 0.5).astype(np.float32)
    disparity[:50] = np.nan
    truth[:, :40] = np.nan
    return reliability(disparity, confidence, truth, 1.0)


def test_what_is_calibrated_lies_on_the_diagonal() -> None:
    found = drawn()
    assert found[0].sum() == 150 * 260
    rows = reliability_rows(found)
    assert expected_error(rows) < 0.01
    assert len(rows) == 7
    assert sum(row["part"] for row in rows) == pytest.approx(1.0)
    for row in rows:
        # Four standard deviations of a share among some 5,000.
        assert row["right"] == pytest.approx(row["confidence"], abs=0.03)


def test_what_is_too_sure_is_told_by_how_much() -> None:
    assert expected_error(reliability_rows(drawn(0.2))) == pytest.approx(0.2, abs=0.01)


def test_parts_add_up() -> None:
    whole = drawn() + drawn(0.2)
    assert whole[0].sum() == 2 * drawn()[0].sum()
    assert expected_error(reliability_rows(whole)) == pytest.approx(0.1, abs=0.01)
    assert np.isnan(expected_error(reliability_rows(0 * whole)))
