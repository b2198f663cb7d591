# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Range of disparities that is searched."""

from __future__ import annotations

from uw_visibility.config.schema import StereoConfig
from uw_visibility.errors import InputError


def disparity_limits(config: StereoConfig, width: int) -> tuple[int, int]:
    """Return the smallest and the largest disparity searched, px.

    Parameters
    ----------
    config : StereoConfig
        `min_disparity` and `max_disparity`; 0 stands for a quarter of the width.
    width : int
        Of the images, px.

    Raises
    ------
    InputError
        If they leave nothing to search.
    """
    low = config.min_disparity
    high = config.max_disparity or width // 4
    high = min(high, width - 16)
    if high - low < 8:
        raise InputError(
            f"stereo.min_disparity is {low} and the largest disparity {high} px: "
            "leave at least 8 px between them"
        )
    return low, high
