# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Linear algebra of small matrices for compiled kernels.

In a kernel, NumPy's own calls BLAS and LAPACK through `scipy.linalg`, whose import is a
tenth of a node's start, and which compute other last bits on other processors.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit


@njit(nogil=True)
def solve(system: Any, right: Any) -> Any:
    """Solve a system of linear equations: elimination with pivots from a column.

    Parameters
    ----------
    system : (n, n) float64 ndarray
        Left side.
    right : (n, m) float64 ndarray
        Right sides, as columns.

    Returns
    -------
    (n, m) float64 ndarray
        A solution for each of the right sides.

    Raises
    ------
    LinAlgError
        If the system is singular, or a number is not finite.
    """
    if not (np.isfinite(system).all() and np.isfinite(right).all()):
        raise np.linalg.LinAlgError("a system of equations has numbers that are not finite")
    left = system.copy()
    solution = right.copy()
    size = len(left)
    for step in range(size):
        pivot = step
        for row in range(step + 1, size):
            if abs(left[row, step]) > abs(left[pivot, step]):
                pivot = row
        if left[pivot, step] == 0.0:
            raise np.linalg.LinAlgError("a system of equations is singular")
        for column in range(size):
            kept = left[step, column]
            left[step, column] = left[pivot, column]
            left[pivot, column] = kept
        for column in range(solution.shape[1]):
            kept = solution[step, column]
            solution[step, column] = solution[pivot, column]
            solution[pivot, column] = kept
        for row in range(step + 1, size):
            factor = left[row, step] / left[step, step]
            for column in range(step, size):
                left[row, column] -= factor * left[step, column]
            for column in range(solution.shape[1]):
                solution[row, column] -= factor * solution[step, column]
    for step in range(size - 1, -1, -1):
        for column in range(solution.shape[1]):
            rest = solution[step, column]
            for known in range(step + 1, size):
                rest -= left[step, known] * solution[known, column]
            solution[step, column] = rest / left[step, step]
    return solution


@njit(nogil=True)
def product(left: Any, right: Any) -> Any:
    """Multiply two matrices.

    Parameters
    ----------
    left : (n, k) float64 ndarray
    right : (k, m) float64 ndarray

    Returns
    -------
    (n, m) float64 ndarray
    """
    result = np.zeros((left.shape[0], right.shape[1]))
    for row in range(left.shape[0]):
        for inner in range(left.shape[1]):
            for column in range(right.shape[1]):
                result[row, column] += left[row, inner] * right[inner, column]
    return result


@njit(nogil=True)
def apply(matrix: Any, vector: Any) -> Any:
    """Multiply a matrix and a vector.

    Parameters
    ----------
    matrix : (n, k) float64 ndarray
    vector : (k,) float64 ndarray

    Returns
    -------
    (n,) float64 ndarray
    """
    result = np.zeros(len(matrix))
    for row in range(len(matrix)):
        for inner in range(len(vector)):
            result[row] += matrix[row, inner] * vector[inner]
    return result
