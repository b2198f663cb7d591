# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Matcher whose dense disparities come from a network of one's own, in ONNX.

Support points and mesh stay those of ELAS. What the network says is compared with what it says
of the mirrored pair: occlusions and mismatches differ, and how far the others differ tells the
disparities' error and how sure each of them is.
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

# Standard deviation of the mean brightness that is taken off a restored view, px: contrast that
# is wider was not restored.
_WIDEST_DETAIL = 8.0


class OnnxMatcher(Matcher):
    """ELAS whose dense search is a network (`StereoConfig.model`); see `Matcher`.

    Raises `InputError` if the model is missing or no stereo network; see `Network`.
    """

    def __init__(
        self, shape: tuple[int, int], disparities: tuple[int, int], config: StereoConfig,
        workers: Workers,
    ) -> None:
        if config.min_confidence > 0 and not config.network_check:
            raise InputError(
                "stereo.min_confidence needs stereo.network_check, which tells the confidence: "
                "set it, or set stereo.min_confidence to 0")
        super().__init__(shape, disparities, config, workers)
        self._network = Network(config, "stereo", 2, shape, workers.threads, disparities[1])

    def dense_disparity(
        self, support: SupportPoints, *, confidence: bool = True, least_for_colour: float = 0.0,
    ) -> DenseMatch:
        """Match every pixel of the described pair; `support` changes nothing.

        Without the second run (`StereoConfig.network_check`) none is rated.
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
        """Set to NaN, as ELAS does, what noise explains, as in open water, and small segments."""
        self._remove_noise(disparity)
        remove_segments(disparity, self._config.segment_size, self._config.segment_difference)

    def _run(self, left: NDArray[np.float32], right: NDArray[np.float32]) -> DisparityMap:
        """Return the network's disparities, px; NaN beyond the limits and beyond the view."""
        found = self._network.run(np.ascontiguousarray(left), np.ascontiguousarray(right))
        found = found * np.float32(self._network.columns_per_px)
        low, high = self._disparities
        columns = np.arange(found.shape[1], dtype=np.float32)
        found[(found < low) | (found > high) | (found > columns)] = np.nan
        return found

    def _pixels(self, view: ContrastNormalizer) -> NDArray[np.float32]:
        """Return the pixels that the network takes, (H, W, C), 0..1."""
        if self._config.network_images == "restored":
            grey = view.grey.astype(np.float32)
            detail = (grey - cv2.GaussianBlur(grey, (0, 0), _WIDEST_DETAIL)) * view.gain
            image = np.clip(0.5 + detail / 255, 0, 1)
        else:
            image = view.image / np.float32(np.iinfo(view.image.dtype).max)
        return self._network.channels_of(image)


def _difference(left: DisparityMap, right: DisparityMap) -> NDArray[np.float32]:
    """Left disparities less those of the same points in the right view; NaN where unknown."""
    rows, columns = np.indices(left.shape, np.float32)
    seen = cv2.remap(
        right, columns - np.nan_to_num(left), rows, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=math.nan)
    return np.asarray(left - seen)


def rate_difference(
    difference: NDArray[np.float32], tolerance: float, searched: float
) -> tuple[float, NDArray[np.float32]]:
    """Find the error of disparities, and how sure each is, from what two views say of a point.

    A mixture: of a right match the two disparities have independent normal errors, of a
    mismatch they differ by anything that was searched. An error that both views share shows
    in no difference; so the error is at least `DISPARITY_STDDEV`, and a network that is wrong
    alike in both is rated too high.

    Parameters
    ----------
    difference : (H, W) float32 ndarray
        px; NaN where one of them is unknown.
    tolerance : float
        Largest difference of a match, px.
    searched : float
        Largest less smallest disparity, px.

    Returns
    -------
    stddev : float
        Standard deviation of a match, px.
    confidence : (H, W) float32 ndarray
        Probability of an error within 1 px; 0 where there is no match.
    """
    size = np.abs(difference)
    agree = size <= tolerance
    confidence = np.zeros(difference.shape, np.float32)
    if not agree.any():
        return DISPARITY_STDDEV, confidence
    differ = max(median_deviation(difference[agree]), math.sqrt(2) * DISPARITY_STDDEV)
    stddev = differ / math.sqrt(2)
    # Mismatches that agree by chance are as many as their share of what was searched.
    fail = 1.0 - np.count_nonzero(agree) / np.count_nonzero(np.isfinite(size))
    wrong = min(fail / max(1.0 - tolerance / searched, 1e-3), 1.0)
    found = size[agree]
    normal = np.exp(-0.5 * (found / differ) ** 2) / (math.sqrt(2 * math.pi) * differ)
    right = (1.0 - wrong) * normal
    right /= right + wrong / (2.0 * searched)
    # Of two errors whose difference is known, each has half of it on average.
    spread = differ / 2.0
    within = ndtr((1.0 - found / 2.0) / spread) - ndtr((-1.0 - found / 2.0) / spread)
    confidence[agree] = right * within
    return stddev, confidence
