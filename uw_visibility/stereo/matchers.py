# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stereo matchers by name, and what the pipeline asks of one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.images.arrays import DisparityMap, Points
from uw_visibility.images.view import View
from uw_visibility.stereo.airlight import AirlightPrior
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas import DenseMatch, Matcher, SupportPoints


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

    def support_points(
        self, airlight: AirlightPrior | None = None, earlier: Points | None = None
    ) -> SupportPoints:
        """Match the pair sparsely and robustly."""

    def swapped_ratio(self) -> float:
        """Return how many times the matches the pair has with its images exchanged."""

    def coarse_disparity(self, support: SupportPoints) -> DisparityMap:
        """Interpolate the sparse matches; NaN outside of them."""

    def dense_disparity(
        self,
        support: SupportPoints,
        airlight: AirlightPrior | None = None,
        *,
        confidence: bool = True,
        least_for_colour: float = 0.0,
    ) -> DenseMatch:
        """Match every pixel."""


MATCHERS: dict[
    str, Callable[[tuple[int, int], tuple[int, int], StereoConfig, Workers], StereoMatcher]
] = {"elas": Matcher}
"""Makers of matchers, of height and width, limits of disparity, px, parameters and threads:
another one is an entry here."""

MATCHER = "elas"
"""The one that is used; a parameter once there are several."""
