# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Small systems of equations: right, and the same bits for any number of BLAS's threads."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from uw_visibility.compute.linear import solve

SOLVE = """
import hashlib, numpy as np
from uw_visibility.compute.linear import solve
rng, digest = np.random.default_rng(0), hashlib.sha256()
for size in (2, 3, 6, 7):
    for _ in range(100):
        half = rng.normal(size=(size, size))
        matrix = half @ half.T + 0.1 * np.eye(size)
        digest.update(solve(matrix, rng.normal(size=(size, 2))).tobytes())
print(digest.hexdigest())
"""


@pytest.mark.parametrize("columns", [(), (3,)])
def test_a_system_is_solved(columns: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    matrix = rng.normal(size=(6, 6)) + 4.0 * np.eye(6)
    expected = rng.normal(size=(6, *columns))
    np.testing.assert_allclose(solve(matrix, matrix @ expected), expected, rtol=1e-9)


def test_threads_of_blas_do_not_change_a_bit() -> None:
    digests = {
        subprocess.run(
            [sys.executable, "-c", SOLVE], check=True, capture_output=True, text=True,
            env={**os.environ, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads},
        ).stdout
        for threads in ("1", "2")
    }
    assert len(digests) == 1
