# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Synthetic pair, and parameters for it, to compile kernels before the first frame."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import Image
from uw_visibility.optics.light_model import attenuate


def warm_up_config(config: PipelineConfig) -> PipelineConfig:
    """Configuration that compiles the same kernels for images of any size.

    The built-in parts are compiled even if networks are configured: the node falls back to them,
    and networks are tested at the real size. Flat field and limits of disparity are replaced, since
    those of the real images do not fit a small pair.
    """
    config = config.built_in()
    camera, stereo = config.camera, config.stereo
    if camera.flat_field or camera.flat_field_right:
        camera = replace(camera, flat_field="", flat_field_right="", vignetting=(-0.1, 0.0, 0.0))
    return replace(config, camera=camera, stereo=replace(stereo, min_disparity=0, max_disparity=0))


def warm_up_pair(
    shape: tuple[int, int], dtype: np.dtype[Any], *, grey: bool = False, smooth: bool = False
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Pair of three planes under water, which exercises every stage.

    Its texture counts as noise, unless `smooth` is set.
    """
    height, width = shape
    texture = np.random.default_rng(0).random((height, width, 3))
    if smooth:
        texture = cv2.normalize(cv2.GaussianBlur(texture, (0, 0), 4.0), None, 0, 1, cv2.NORM_MINMAX)
    left, right = np.empty((2, height, width, 3))
    for part, disparity in enumerate((12, 8, 5)):
        rows = slice(part * height // 3, (part + 1) * height // 3)
        ranges = np.full(texture[rows].shape[:2], 16 / disparity)
        left[rows] = attenuate(texture[rows], ranges, (0.5, 0.3, 0.2), (1.0, 1.0, 1.0))
        right[rows] = np.roll(left[rows], -disparity, axis=1)
    scale = 0.8 * np.iinfo(dtype).max
    first, second = ((scale * image).astype(dtype) for image in (left, right))
    return (first[..., 1], second[..., 1]) if grey else (first, second)


def warm_up_scene(image: Image) -> tuple[NDArray[Any], NDArray[np.float32]]:
    """Image with open water in view, and its ranges, which exercise the whole estimator."""
    height, width = image.shape[:2]
    open_water = slice(0, height // 3)
    image = image.copy()
    brightness = np.linspace(0.6, 0.4, height // 3)[:, np.newaxis, np.newaxis]
    image[open_water] = brightness * np.iinfo(image.dtype).max
    ranges = np.tile(np.linspace(1.0, 4.0, height, dtype=np.float32)[:, np.newaxis], (1, width))
    ranges[open_water] = np.nan
    return image, ranges
