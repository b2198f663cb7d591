# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Degenerate pairs through library and pipeline: answered or refused, and nothing absurd told."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

from fuzz import Outcome

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from degenerate import Picture, examine

# Width of most pictures, and of one in so many, px.
SMALL, LARGE, LARGE_ONE_IN = 320, 1500, 60


class Cases:
    """Pairs of which a channel is lost, a row is lit, all is noise, and so on."""

    case = ""

    def __init__(self, _: Path) -> None:
        warnings.simplefilter("error")

    def run(self, seed: int) -> Outcome:
        """Process a pair."""
        large = seed % LARGE_ONE_IN == LARGE_ONE_IN - 1
        picture = Picture.random(seed, LARGE if large else SMALL)
        self.case = str(picture)
        refused = examine(picture)
        return Outcome(self.case, "refused" if refused else "read", refused)
