# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stereo matchers by name, what the pipeline asks of one, and the disparities it searches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import DisparityMap, Points
from uw_visibility.images.network import ONNX, load
from uw_visibility.images.view import View
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas import DenseMatch, Matcher, SupportPoints
from uw_visibility.stereo.onnx_matcher import OnnxMatcher


class StereoMatcher(Protocol):
    """Matcher of pairs of one size; see `uw_visibility.stereo.elas.Matcher`, the first of them.

    A pair is described, raw or with its contrast restored; then matched sparsely, and
    after that coarsely (step 1) or densely (step 2).
    """

    def describe_raw(
        self, contrast: tuple[ContrastNormalizer, ContrastNormalizer], left: View, right: View
    ) -> None:
        """Take in a pair as it is."""

    def describe_view(self, side: int, image: ContrastNormalizer) -> None:
        """Take in one view with its contrast restored: 0 is the left one, 1 the right."""

    def support_points(self, earlier: Points | None = None) -> SupportPoints:
        """Match the pair sparsely and robustly."""

    def swapped_ratio(self) -> float:
        """Return how many times the matches the pair has with its images exchanged."""

    def coarse_disparity(self, support: SupportPoints) -> DisparityMap:
        """Interpolate the sparse matches; NaN outside of them."""

    def dense_disparity(
        self,
        support: SupportPoints,
        *,
        confidence: bool = True,
        least_for_colour: float = 0.0,
    ) -> DenseMatch:
        """Match every pixel."""


MATCHERS: dict[
    str, Callable[[tuple[int, int], tuple[int, int], StereoConfig, Workers], StereoMatcher]
] = {"elas": Matcher, ONNX: OnnxMatcher}
"""Makers of matchers, of height and width, limits of disparity, px, parameters and threads:
another one is an entry here."""

MATCHER = StereoConfig.matcher
"""The one of step 1, and by default of step 2 (parameter `stereo.matcher`)."""


def check_matcher(config: StereoConfig, threads: int) -> None:
    """Refuse a matcher that there is not, or a model that cannot be loaded."""
    if config.matcher not in MATCHERS:
        raise InputError(
            f"parameter stereo.matcher is {config.matcher!r}: give one of {', '.join(MATCHERS)}")
    if config.matcher == ONNX:
        load(config, "stereo", 2, threads)


def disparity_limits(config: StereoConfig, width: int) -> tuple[int, int]:
    """Smallest and largest disparity searched in images of a width, px, 0 for a quarter of it."""
    low = config.min_disparity
    high = config.max_disparity or width // 4
    high = min(high, width - 16)
    if high - low < 8:
        raise InputError(
            f"stereo.min_disparity is {low} and the largest disparity {high} px: "
            "leave at least 8 px between them"
        )
    return low, high
