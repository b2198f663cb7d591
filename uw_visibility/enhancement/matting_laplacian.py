# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Closed-form matting of a disparity map: the reference form of the guided filter.

Levin, Lischinski and Weiss, doi 10.1109/TPAMI.2007.1177.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uw_visibility.enhancement.guided_filter import CELL, NO_PLANE, GuidedFilter

if TYPE_CHECKING:
    import scipy.sparse

# Weight λ of the data beside the smoothness that the image asks for.
DATA_WEIGHT = 10.0
TOLERANCE = 1e-5
ITERATIONS = 2000
# Windows of 3 x 3 cells.
OFFSETS = tuple((y, x) for y in (0, 1, 2) for x in (0, 1, 2))


def solve_matting(
    guided: GuidedFilter,
    coarse: NDArray[np.float32],
    confidence: NDArray[np.float32],
    guide: NDArray[np.generic],
    disparity: NDArray[np.float32],
    dense_confidence: NDArray[np.float32],
) -> bool:
    """Minimise dᵀLd + λ Σ confidence (d - coarse)², with L the matting Laplacian of the image.

    Solved on the guided filter's finest grid, from its result, and brought to
    the image's resolution with its coefficients. Parameters and result are
    those of `GuidedFilter.run`.
    """
    # Imported here, since it takes long, and the guided filter does without.
    import scipy.sparse

    if not guided.run(coarse, confidence, guide, disparity, dense_confidence):
        return False
    limits = guided.reduce(coarse, confidence, guide)
    finest = guided.levels[0]
    if min(finest.value.shape) < 3:
        return True
    data = DATA_WEIGHT * finest.weight.astype(np.float64).ravel()
    system = laplacian(finest.guide, guided.smoothness) + scipy.sparse.diags(data)
    height, width = finest.value.shape
    sampled = disparity[CELL // 2 :: CELL, CELL // 2 :: CELL]
    padding = ((0, height - sampled.shape[0]), (0, width - sampled.shape[1]))
    start = np.pad(sampled, padding, mode="edge").astype(np.float64).ravel()
    solution = conjugate_gradient(system, data * finest.value.ravel(), start)
    finest.value[:] = solution.reshape(height, width)
    finest.prior[:] = finest.value
    finest.weight[:] = 1
    guided.regress(radius=1)
    kept = dense_confidence.copy()
    guided.apply(guide, NO_PLANE, limits, disparity, dense_confidence)
    dense_confidence[:] = kept
    return True


def laplacian(guide: NDArray[np.float32], smoothness: float) -> scipy.sparse.csr_matrix:
    """Matting Laplacian of a small image.

    Parameters
    ----------
    guide : (h, w, 3) float32 ndarray
        The image, 0..1 or centred on 0; at least 3 x 3 pixels.
    smoothness : float
        Regularisation ε of the colour lines' slopes.

    Returns
    -------
    (h * w, h * w) sparse matrix
        Symmetric, positive semidefinite; constants are in its null space.
    """
    import scipy.sparse

    height, width = guide.shape[:2]
    index = np.arange(height * width).reshape(height, width)
    rows, columns = height - 2, width - 2
    members = np.stack(
        [index[y : y + rows, x : x + columns].ravel() for y, x in OFFSETS], axis=1
    )
    colours = guide.reshape(-1, 3).astype(np.float64)[members]
    centred = colours - colours.mean(axis=1, keepdims=True)
    count = len(OFFSETS)
    covariance = np.einsum("nki,nkj->nij", centred, centred) / count
    covariance += np.eye(3) * (smoothness / count)
    affinity = np.einsum("nki,nij,nlj->nkl", centred, np.linalg.inv(covariance), centred)
    blocks = np.eye(count) - (1.0 + affinity) / count
    first = np.repeat(members, count, axis=1).ravel()
    second = np.tile(members, (1, count)).ravel()
    size = height * width
    return scipy.sparse.coo_matrix((blocks.ravel(), (first, second)), shape=(size, size)).tocsr()


def conjugate_gradient(
    system: scipy.sparse.csr_matrix, right: NDArray[np.float64], start: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Solve a symmetric, positive definite system, preconditioned with its diagonal.

    Parameters
    ----------
    system : (n, n) sparse matrix
        The system.
    right, start : (n,) float64 ndarray
        Right side, and where to start from.

    Returns
    -------
    (n,) float64 ndarray
        The solution, to a relative residual of `TOLERANCE`.
    """
    inverse = 1.0 / system.diagonal()
    solution = start.copy()
    residual = right - system @ solution
    preconditioned = inverse * residual
    direction = preconditioned.copy()
    energy = float(residual @ preconditioned)
    goal = TOLERANCE * float(np.linalg.norm(right))
    for _ in range(ITERATIONS):
        if float(np.linalg.norm(residual)) <= goal:
            break
        ahead = system @ direction
        step = energy / float(direction @ ahead)
        solution += step * direction
        residual -= step * ahead
        preconditioned = inverse * residual
        previous, energy = energy, float(residual @ preconditioned)
        direction = preconditioned + (energy / previous) * direction
    return solution
