# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Matcher whose dense disparities come from the user's own network, in ONNX.

Support points and mesh are those of ELAS. The network's disparities are compared with those of the
mirrored pair: at occlusions and mismatches they differ, and elsewhere the distribution of the
differences gives the disparities' standard deviation and confidence.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from uw_visibility.compute.robust import median_deviation
from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.images.network import Network
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas import DenseMatch, Matcher, SupportPoints
from uw_visibility.stereo.elas.postprocess import remove_segments
from uw_visibility.stereo.rig import DISPARITY_STDDEV

# Standard deviation of the Gaussian whose mean is subtracted from a restored view, px: coarser
# contrast was not restored.
_WIDEST_DETAIL = 8.0


class OnnxMatcher(Matcher):
    """ELAS whose dense search is a network (`StereoConfig.model`); see `Matcher`.

    Raises `InputError` if the model is missing or not a stereo network, see `Network`, and if
    `min_confidence` is set without `network_check`.
    """

    def __init__(
        self, shape: tuple[int, int], disparities: tuple[int, int], config: StereoConfig,
        workers: Workers,
    ) -> None:
        if config.min_confidence > 0 and not config.network_check:
            raise InputError(
                "stereo.min_confidence needs stereo.network_check, which gives the confidence: "
                "turn it on, or set stereo.min_confidence to 0")
        super().__init__(shape, disparities, config, workers)
        self._network = Network(config, "stereo", 2, shape, workers.threads, disparities[1])

    def dense_disparity(
        self, support: SupportPoints, *, confidence: bool = True, least_for_colour: float = 0.0,
    ) -> DenseMatch:
        """Match every pixel of the described pair; `support` is not used.

        Without the second run (`StereoConfig.network_check`) there is no confidence.
        Raises `uw_visibility.images.network.NetworkError` if the network fails.
        """
        left, right = (self._pixels(self._images[side]) for side in (0, 1))
        disparity = self._run(left, right)
        if not self._config.network_check:
            self._clear(disparity)
            return DenseMatch(disparity, None, disparity, DISPARITY_STDDEV)
        best_right = self._run(right[:, ::-1], left[:, ::-1])[:, ::-1]
        low, high = self._disparities
        stddev, rated = rate_difference(
            _difference(disparity, best_right), self._config.left_right_tolerance, high - low)
        disparity[~(rated > 0) | (rated < self._config.min_confidence)] = np.nan
        self._clear(disparity)
        rated[np.isnan(disparity)] = 0
        for_colour = disparity.copy()
        for_colour[rated < least_for_colour] = np.nan
        return DenseMatch(disparity, rated if confidence else None, for_colour, stddev)

    def _clear(self, disparity: DisparityMap) -> None:
        """Set matches that are no better than noise and small segments to NaN, as ELAS does."""
        self._remove_noise(disparity)
        remove_segments(disparity, self._config.segment_size, self._config.segment_difference)

    def _run(self, left: NDArray[np.float32], right: NDArray[np.float32]) -> DisparityMap:
        """Return the network's disparities, px; NaN outside of the limits or of the right view."""
        found = self._network.run(np.ascontiguousarray(left), np.ascontiguousarray(right))
        found = found * np.float32(self._network.columns_per_px)
        low, high = self._disparities
        columns = np.arange(found.shape[1], dtype=np.float32)
        found[(found < low) | (found > high) | (found > columns)] = np.nan
        return found

    def _pixels(self, view: ContrastNormalizer) -> NDArray[np.float32]:
        """Return the network's input of a view, (H, W, C), 0..1."""
        if self._config.network_images == "restored":
            grey = view.grey.astype(np.float32)
            detail = (grey - cv2.GaussianBlur(grey, (0, 0), _WIDEST_DETAIL)) * view.gain
            image = np.clip(0.5 + detail / 255, 0, 1)
        else:
            image = view.image / np.float32(np.iinfo(view.image.dtype).max)
        return self._network.channels_of(image)


def _difference(left: DisparityMap, right: DisparityMap) -> NDArray[np.float32]:
    """Left disparities minus those of the same points in the right view; NaN where unknown."""
    rows, columns = np.indices(left.shape, np.float32)
    seen = cv2.remap(
        right, columns - np.nan_to_num(left), rows, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=math.nan)
    return np.asarray(left - seen)


def rate_difference(
    difference: NDArray[np.float32], tolerance: float, searched: float
) -> tuple[float, NDArray[np.float32]]:
    """Standard deviation, px, and confidence (H, W) of disparities, from those of the two views.

    A mixture model: the two disparities of a correct match have independent normal errors, those of
    a mismatch differ uniformly within the searched range. Errors that both views share make no
    difference: the standard deviation is at least `DISPARITY_STDDEV`, and the confidence of a
    network with the same errors in both views is too high. Confidence is the probability of an
    error within 1 px; 0 where there is no match.

    `difference` (H, W) is left minus right disparity, px, NaN where one of them is unknown;
    `tolerance` the largest of a match, px, and `searched` the largest minus the smallest disparity,
    px.
    """
    size = np.abs(difference)
    agree = size <= tolerance
    confidence = np.zeros(difference.shape, np.float32)
    if not agree.any():
        return DISPARITY_STDDEV, confidence
    differ = max(median_deviation(difference[agree]), math.sqrt(2) * DISPARITY_STDDEV)
    stddev = differ / math.sqrt(2)
    # Share of mismatches; a part of tolerance / searched of them agrees by chance.
    fail = 1.0 - np.count_nonzero(agree) / np.count_nonzero(np.isfinite(size))
    wrong = min(fail / max(1.0 - tolerance / searched, 1e-3), 1.0)
    found = size[agree]
    normal = np.exp(-0.5 * (found / differ) ** 2) / (math.sqrt(2 * math.pi) * differ)
    right = (1.0 - wrong) * normal
    right /= right + wrong / (2.0 * searched)
    # Given the difference of two errors, each error is half of it on average.
    spread = differ / 2.0
    within = ndtr((1.0 - found / 2.0) / spread) - ndtr((-1.0 - found / 2.0) / spread)
    confidence[agree] = right * within
    return stddev, confidence
