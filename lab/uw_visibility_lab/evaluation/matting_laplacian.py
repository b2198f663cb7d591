# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Closed-form matting of a disparity map: the reference for the guided filter.

Levin, Lischinski and Weiss, doi 10.1109/TPAMI.2007.1177.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.matting import CELL, NO_PLANE, GuidedFilter
from uw_visibility.images.arrays import DisparityMap, Map

# Weight λ of the data beside the smoothness that the image asks for.
DATA_WEIGHT = 10.0
ITERATIONS = 2000
# Windows of 3 x 3 cells.
OFFSETS = tuple((y, x) for y in (0, 1, 2) for x in (0, 1, 2))


def refine_by_laplacian(
    coarse: DisparityMap, guide: NDArray[np.generic], config: EnhancementConfig
) -> DisparityMap:
    """Minimise dᵀLd + λ Σ (d - coarse)², with L the matting Laplacian of the image.

    Solved on the guided filter's finest grid, from its result, and brought to the image's
    resolution with its coefficients. Disparities in px; NaN where unknown, and where there was
    none to start from. The image is at least 12 px high and wide.
    """
    guided = GuidedFilter(
        (coarse.shape[0], coarse.shape[1]), config.matting_radius, config.matting_smoothness,
        Workers(1),
    )
    disparity = np.full(coarse.shape, np.nan, np.float32)
    if not guided.run(coarse, guide, disparity):
        return disparity
    limits = guided.reduce(coarse, guide)
    finest = guided.levels[0]
    data = DATA_WEIGHT * finest.weight.astype(np.float64).ravel()
    system = laplacian(finest.guide, config.matting_smoothness) + scipy.sparse.diags(data)
    height, width = finest.value.shape
    sampled = disparity[CELL // 2 :: CELL, CELL // 2 :: CELL]
    padding = ((0, height - sampled.shape[0]), (0, width - sampled.shape[1]))
    start = np.pad(sampled, padding, mode="edge").astype(np.float64).ravel()
    solution, _ = scipy.sparse.linalg.cg(
        system, data * finest.value.ravel(), start, atol=0.0, maxiter=ITERATIONS,
        M=scipy.sparse.diags(1.0 / system.diagonal()),
    )
    finest.value[:] = solution.reshape(height, width)
    finest.prior[:] = finest.value
    finest.weight[:] = 1
    guided.regress(radius=1)
    guided.apply(guide, NO_PLANE, limits, disparity)
    return disparity


def laplacian(guide: Map, smoothness: float) -> scipy.sparse.csr_matrix:
    """Matting Laplacian of a small image (h, w, 3), at least 3 x 3 pixels, as a sparse matrix.

    smoothness: regularisation ε of the colour lines' slopes. Symmetric and positive semidefinite;
    constants are in its null space.
    """
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
