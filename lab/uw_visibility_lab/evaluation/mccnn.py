# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""MC-CNN, a learnt peer: CNES's weights and semi-global matching, both from PyPI.

Features of a convolutional network, compared by their cosine (Žbontar and LeCun 2016,
jmlr.org/papers/v17/15-535, the fast architecture), semi-global matching by libSGM, sub-pixel
refinement by a parabola, and a left/right check. `MCCNN` brings its weights as ONNX.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import DisparityMap, Image8

TITLE = "MC-CNN with SGM, raw pair"
PACKAGES = {"mc_cnn": "MCCNN", "c_libsgm": "libsgm", "onnxruntime": "onnxruntime"}
"""What it needs: modules, and their names on PyPI."""

# Pixels that a feature sees to each side.
_REACH = 5
# Defaults of `mc_cnn_fast_penalty` in CNES's Pandora, after the publication: penalties of a step of
# one pixel and of a larger one, by what they are divided where one view or both have an edge
# (in standard deviations of the image), and the former along columns.
_STEP, _JUMP = np.float32(2.3), np.float32(42.3)
_DIVISORS = np.array((1, 3, 6), np.float32)
_EDGE, _COLUMNS = 0.08, np.float32(1.5)
# Costs are 1 - cosine; what has no partner costs more than any match and jump.
_NO_PARTNER = 2.0 + float(_JUMP) + 1.0
_DIRECTIONS = np.array(
    [(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1)], np.int32)


def missing() -> list[str]:
    """Return the packages that are not installed, by their names on PyPI."""
    return [package for module, package in PACKAGES.items() if find_spec(module) is None]


def match(left: Image8, right: Image8, max_disparity: int) -> DisparityMap:
    """Match a rectified pair, (H, W, 3) uint8 each; (H, W) float32, px, NaN where unmatched.

    Takes 10 bytes for each pixel and disparity, and 2 kB for each pixel.
    """
    import c_libsgm

    images = [_standardised(image) for image in (left, right)]
    costs = _costs(_features(images[0]), _features(images[1]), max_disparity)
    steps, jumps = _penalties(images)
    costs = c_libsgm.sgm_api(
        costs, steps, jumps, _DIRECTIONS, _NO_PARTNER, np.ones_like(images[0]))["cv"]
    disparity, other = _best(costs)
    rows, columns = np.indices(disparity.shape)
    seen = other[rows, np.maximum(columns - np.rint(disparity).astype(np.intp), 0)]
    disparity[np.abs(disparity - seen) > 1] = np.nan
    return disparity


def _standardised(image: Image8) -> NDArray[np.float32]:
    values = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.asarray((values - values.mean()) / (values.std() or 1.0), np.float32)


@cache
def _session() -> Any:
    import onnxruntime
    from mc_cnn.weights import get_weights

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(
        str(get_weights("onnx_fast_dw", "middlebury")), options,
        providers=["CPUExecutionProvider"])


def _features(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the features of each pixel, (H, W, C), of length 1."""
    found, = _session().run(None, {"input": np.pad(image, _REACH, mode="edge")})
    return np.ascontiguousarray(np.moveaxis(found, 0, 2))


def _costs(
    left: NDArray[np.float32], right: NDArray[np.float32], most: int
) -> NDArray[np.float32]:
    height, width = left.shape[:2]
    costs = np.full((height, width, most + 1), _NO_PARTNER, np.float32)
    for d in range(min(most + 1, width)):
        costs[:, d:, d] = 1 - np.einsum("yxc,yxc->yx", left[:, d:], right[:, : width - d])
    return costs


def _penalties(
    images: Sequence[NDArray[np.float32]]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the penalties of a step and of a jump, by pixel and direction."""
    edges = np.stack([
        np.sum([np.abs(image - np.roll(image, shift, (0, 1))) > _EDGE for image in images], axis=0)
        for shift in _DIRECTIONS], axis=2)
    divisors = _DIVISORS[edges]
    along_columns = np.where(_DIRECTIONS[:, 1] == 0, _COLUMNS, np.float32(1))
    return _STEP / (divisors * along_columns), _JUMP / divisors


def _best(costs: NDArray[np.float32]) -> tuple[DisparityMap, DisparityMap]:
    """Return the best disparities of the left view, to parts of a pixel, and of the right one."""
    height, width, count = costs.shape
    found = np.zeros((2, height, width), np.intp)
    least = np.full(found.shape, np.inf, np.float32)
    for d in range(min(count, width)):
        cost = costs[:, d:, d]
        for best, cheapest, at in zip(
                found, least, (np.s_[:, d:], np.s_[:, : width - d]), strict=True):
            better = cost < cheapest[at]
            cheapest[at][better] = cost[better]
            best[at][better] = d
    rows, columns = np.indices((height, width))
    inner = (found[0] > 0) & (found[0] < np.minimum(columns, count - 1))
    before, here, after = (
        costs[rows, columns, np.where(inner, found[0] + step, 0)] for step in (-1, 0, 1))
    bend = before - 2 * here + after
    inner &= bend > 0
    offset = np.where(inner, (before - after) / np.where(inner, 2 * bend, 1), 0)
    return np.asarray(found[0] + offset, np.float32), found[1].astype(np.float32)
