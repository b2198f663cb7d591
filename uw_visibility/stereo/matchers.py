# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stereo matchers by name, and the limits of their disparities."""

from __future__ import annotations

from collections.abc import Callable

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.errors import InputError
from uw_visibility.images.network import ONNX, load
from uw_visibility.stereo.elas import Matcher
from uw_visibility.stereo.onnx_matcher import OnnxMatcher

MATCHERS: dict[
    str, Callable[[tuple[int, int], tuple[int, int], StereoConfig, Workers], Matcher]
] = {"elas": Matcher, ONNX: OnnxMatcher}
"""Constructors of matchers by name, from height and width, disparity limits, px, parameters and
threads. A further matcher is added here and needs the methods of `Matcher`."""

MATCHER = StereoConfig.matcher
"""Matcher of step 1, and default of step 2 (parameter `stereo.matcher`)."""


def check_matcher(config: StereoConfig, threads: int) -> None:
    """Refuse an unknown matcher, or a model that cannot be loaded."""
    if config.matcher not in MATCHERS:
        raise InputError(
            f"parameter stereo.matcher is {config.matcher!r}: give one of {', '.join(MATCHERS)}")
    if config.matcher == ONNX:
        load(config, "stereo", 2, threads)


def disparity_limits(config: StereoConfig, width: int) -> tuple[int, int]:
    """Smallest and largest disparity to search, px; a largest of 0 means a quarter of `width`."""
    low = config.min_disparity
    high = config.max_disparity or width // 4
    high = min(high, width - 16)
    if high - low < 8:
        raise InputError(
            f"stereo.min_disparity is {low} and the largest disparity {high} px: "
            "leave at least 8 px between them"
        )
    return low, high
