# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Quantiles, against those of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import gammaincinv, ndtri

from uw_visibility.compute.quantiles import chi_squared_quantile, normal_quantile


def test_normal_quantiles() -> None:
    probabilities = np.concatenate(
        (np.geomspace(1e-300, 0.5, 200), np.linspace(0.01, 0.99, 99), 1 - np.geomspace(1e-15, 0.1))
    ).reshape(1, -1)
    assert_allclose(normal_quantile(probabilities), ndtri(probabilities), rtol=1e-13, atol=1e-15)
    assert normal_quantile(0.975) == pytest.approx(1.959964, abs=1e-6)
    assert normal_quantile([0.0, 1.0]).tolist() == [-np.inf, np.inf]


@pytest.mark.parametrize("degrees", [1, 2, 4, 6])
@pytest.mark.parametrize("probability", [0.5, 0.95, 0.999, 0.999999])
def test_chi_squared_quantiles(degrees: int, probability: float) -> None:
    expected = 2 * gammaincinv(degrees / 2, probability)
    assert chi_squared_quantile(degrees, probability) == pytest.approx(expected, rel=1e-9)


def test_chi_squared_quantile_at_zero_and_for_other_degrees() -> None:
    assert chi_squared_quantile(1, 0.0) == 0.0
    assert chi_squared_quantile(4, 0.0) == pytest.approx(0.0, abs=1e-7)
    for degrees in (0, 3):
        with pytest.raises(ValueError, match=f"{degrees} degrees of freedom"):
            chi_squared_quantile(degrees, 0.9)
