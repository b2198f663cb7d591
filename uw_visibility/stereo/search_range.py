# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Range of disparities that is searched."""

from __future__ import annotations

from uw_visibility.config.schema import StereoConfig
from uw_visibility.errors import InputError


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
