# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Small systems of equations in kernels, the same bits whatever the number of threads."""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit


@njit(nogil=True)
def solve(matrix: Any, right: Any) -> Any:
    """Solve a system of a few equations, matrix (N, N) and right side (N,) or (N, K).

    By the inverse: the last digit of LAPACK's own solution (gesv) depends on how many threads
    OpenBLAS has in Ubuntu 24.04's SciPy, which takes them for six equations already.
    """
    return np.linalg.inv(matrix) @ right
