# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Depth samples in time, and interpolation between them."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class DepthSample:
    """Depth at a stamp, with its variance.

    Attributes
    ----------
    stamp : int
        In ns.
    depth : float
        m, positive down; NaN where it is not known.
    variance : float
        m².
    """

    stamp: int
    depth: float
    variance: float

    @property
    def depth_stddev(self) -> float:
        """Standard deviation of `depth`, m."""
        return self.variance**0.5


def interpolate(
    samples: Sequence[DepthSample], stamp: int, longest_gap: float
) -> DepthSample | None:
    """Interpolate the depth linearly at a stamp.

    Parameters
    ----------
    samples : sequence of DepthSample
        By rising stamp.
    stamp : int
        In ns.
    longest_gap : float
        Neighbours further apart than this are not neighbours, s.

    Returns
    -------
    DepthSample or None
        None where the samples do not enclose the stamp closely.
    """
    index = bisect_left(samples, stamp, key=lambda sample: sample.stamp)
    if index == len(samples):
        return None
    after = samples[index]
    if after.stamp == stamp:
        return after
    if index == 0:
        return None
    before = samples[index - 1]
    gap = after.stamp - before.stamp
    if gap > longest_gap * 1e9:
        return None
    share = (stamp - before.stamp) / gap
    # Errors of a sensor are alike from one value to the next, so the mean of
    # two is not taken to be better than one.
    return DepthSample(
        stamp,
        before.depth + share * (after.depth - before.depth),
        before.variance + share * (after.variance - before.variance),
    )
