# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Ranges of both views without holes, which their images are restored with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap, Mask, RangeMap
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.stereo.views import in_right_view


class FilledRanges(NamedTuple):
    """Ranges of one view without holes.

    Attributes
    ----------
    range_map : ndarray
        ``(H, W)`` float32, m; infinite where the filled disparity lies at or beyond infinity.
    matched : ndarray
        ``(H, W)`` bool, where the range was measured.
    """

    range_map: RangeMap
    matched: Mask


class FilledStereo(NamedTuple):
    """Disparity of the left view without holes, and ranges.

    Attributes
    ----------
    disparity : ndarray
        ``(H, W)`` float32, px; gaps filled.
    measured : ndarray
        ``(H, W)`` float32, m, of the left view; NaN where unmatched.
    left : FilledRanges
        Of the left view.
    right : FilledRanges or None
        Of the right view, where asked for.
    """

    disparity: DisparityMap
    measured: RangeMap
    left: FilledRanges
    right: FilledRanges | None

    @classmethod
    def of(
        cls, rig: StereoRig, disparity: DisparityMap, filled: DisparityMap, right: bool,
        workers: Workers,
    ) -> FilledStereo:
        """Find the ranges of one view or of both.

        Parameters
        ----------
        rig : StereoRig
        disparity : ndarray
            ``(H, W)`` float32, of the left view, px; NaN where unmatched.
        filled : ndarray
            ``(H, W)`` float32, the same without holes.
        right : bool
            Whether those of the right view are asked for.
        workers : Workers
            Threads.
        """
        left = FilledRanges(rig.range_of_filled(filled), np.isfinite(disparity))
        of_right = None
        if right:
            seen = in_right_view(filled, workers)
            matched = seen == in_right_view(disparity, workers)
            of_right = FilledRanges(rig.range_of_filled(seen), matched)
        return cls(filled, rig.range_from_disparity(disparity), left, of_right)
