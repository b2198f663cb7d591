# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Vote of a recording's frames on the camera's transfer function."""

from __future__ import annotations

import math

# How much likelier, as a logarithm, another transfer is before a frame counts as certain.
CERTAIN = 3.4
# Frames of a recording show one scene, so that they are no more than so many independent ones;
# what they say on average, the latest count, of at least so many, for the transfer to be told.
INDEPENDENT = 4
LATEST = 20
CERTAIN_TOGETHER = 1.7


class TransferVote:
    """Vote of a recording's frames on the camera's transfer, which all of them share."""

    def __init__(self) -> None:
        self._mean = 0.0
        self._frames = 0

    def add(self, log_odds: float) -> None:
        """Take in a frame's log odds of the other transfer, NaN if none; limited to `CERTAIN`."""
        if math.isnan(log_odds):
            return
        self._frames = min(self._frames + 1, LATEST)
        self._mean += (min(max(log_odds, -CERTAIN), CERTAIN) - self._mean) / self._frames

    @property
    def certain(self) -> bool:
        """Whether the transfer is certainly the other one."""
        return self._frames >= INDEPENDENT and self._mean > CERTAIN_TOGETHER
