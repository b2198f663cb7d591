# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Linear algebra of kernels, against NumPy's."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from uw_visibility.compute.linear_algebra import apply, product, solve


@pytest.mark.parametrize("size", [1, 2, 6, 7])
def test_like_numpy(size: int) -> None:
    generator = np.random.default_rng(size)
    system = generator.normal(size=(size, size))
    # A zero on the diagonal is no obstacle.
    system[0, 0] = 0.0 if size > 1 else 1.0
    right = generator.normal(size=(size, 3))
    before = system.copy(), right.copy()
    assert_allclose(solve(system, right), np.linalg.solve(system, right), rtol=1e-9, atol=1e-12)
    assert_allclose(product(system, right), system @ right, atol=1e-13)
    assert_allclose(product(right.T, system), right.T @ system, atol=1e-13)
    assert_allclose(apply(system, right[:, 1]), system @ right[:, 1], atol=1e-13)
    assert np.array_equal(system, before[0]) and np.array_equal(right, before[1])


def test_badly_scaled_systems() -> None:
    """Information of attenuation and of ambient light differ by orders of magnitude."""
    scale = np.array([1e3, 1.0, 1e2, 0.1, 1e4, 0.01])
    basis = np.random.default_rng(0).normal(size=(20, 6))
    system = basis.T @ basis * np.outer(scale, scale)
    expected = np.arange(1.0, 7.0)[:, np.newaxis]
    assert_allclose(solve(system, system @ expected), expected, rtol=1e-5)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_what_has_no_solution_is_refused(value: float) -> None:
    system = np.eye(3)
    system[1, 1] = value
    with pytest.raises(np.linalg.LinAlgError):
        solve(system, np.ones((3, 1)))
    if not np.isfinite(value):
        with pytest.raises(np.linalg.LinAlgError):
            solve(np.eye(3), np.full((3, 1), value))
