# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Baselines: OpenCV's matcher and contrast methods."""

from __future__ import annotations

import cv2
import numpy as np

from uw_visibility.images.arrays import Array, DisparityMap, Image8, RangeMap
from uw_visibility_lab.evaluation.fits import fit_backscatter


def semi_global_matching(left: Image8, right: Image8, max_disparity: int) -> DisparityMap:
    """Match a rectified pair with OpenCV's StereoSGBM in full mode (eight directions).

    Grey or colour; on Middlebury pairs in turbid water, colour gives 0.01 to 0.03 more correct
    pixels. Returns (H, W), left disparity, px; NaN = unmatched.
    """
    channels = 1 if left.ndim == 2 else left.shape[2]
    found = sgbm(max_disparity, channels).compute(left, right)
    # OpenCV's disparities are in sixteenths of a pixel.
    disparity = found.astype(np.float32) / np.float32(16.0)
    disparity[found < 0] = np.nan
    return disparity


def sgbm(max_disparity: int, channels: int) -> cv2.StereoSGBM:
    """OpenCV's matcher with the settings of its sample stereo_match, in full mode.

    The range of speckles is from OpenCV's documentation instead.
    """
    block = 3
    return cv2.StereoSGBM_create(
        minDisparity=0,
        numDisparities=-(-max_disparity // 16) * 16,
        blockSize=block,
        P1=8 * channels * block**2,
        P2=32 * channels * block**2,
        disp12MaxDiff=1,
        preFilterCap=63,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.StereoSGBM_MODE_HH,
    )


def equalised_matching(left: Image8, right: Image8, max_disparity: int) -> DisparityMap:
    """`semi_global_matching` after `equalise_adaptively` of both images."""
    return semi_global_matching(
        equalise_adaptively(left), equalise_adaptively(right), max_disparity
    )


def equalise_channels(image: Image8) -> Image8:
    """Histogram equalisation of each channel of an (H, W, 3) image."""
    return np.dstack([cv2.equalizeHist(np.ascontiguousarray(image[..., c])) for c in range(3)])


def equalise_adaptively(image: Image8) -> Image8:
    """CLAHE of L* of an (H, W, 3) RGB or of a grey image, as in OpenCV's tutorial."""
    clahe = cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8))
    if image.ndim == 2:
        return clahe.apply(image)
    planes = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)
    planes[..., 0] = clahe.apply(np.ascontiguousarray(planes[..., 0]))
    return np.asarray(cv2.cvtColor(planes, cv2.COLOR_LAB2RGB), dtype=np.uint8)


def balance_by_grey_world(image: Image8) -> Image8:
    """Grey world: scale the channels of an (H, W, 3) image to equal means.

    Buchsbaum 1980, doi:10.1016/0016-0032(80)90058-7.
    """
    means = image.reshape(-1, 3).mean(axis=0)
    return _codes(image * (means.mean() / np.maximum(means, 1.0)))


def sea_thru(image: Image8, ranges: RangeMap) -> Image8:
    """Subtract Sea-thru's backscatter, compensate for its β, and apply grey world.

    The publication has another β for the direct light; here that of the backscatter is used for
    both. Pixels of unknown range (m), and images whose fit fails, stay. See `fit_backscatter`.
    """
    water = fit_backscatter(image, ranges)
    if not np.isfinite(water.attenuation).all():
        return image
    transmitted = np.exp(-water.attenuation * ranges[..., np.newaxis])
    veil = 255.0 * water.ambient_light * (1.0 - transmitted)
    known = np.isfinite(ranges)
    restored = image.astype(np.float64)
    restored[known] = ((image - veil) / transmitted)[known]
    # Means are of the pixels with a range, since open water does not have the scene's colours.
    means = np.maximum(restored[known].mean(axis=0), 1.0)
    restored[known] *= means.mean() / means
    return _codes(restored)


def _codes(values: Array) -> Image8:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
