# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""ELAS, implemented from its publication (Geiger, Roser and Urtasun, ACCV 2010)."""

from uw_visibility.stereo.elas.matcher import DenseMatch, Matcher
from uw_visibility.stereo.elas.support import FEWEST_SUPPORT_POINTS, SupportPoints

__all__ = ["FEWEST_SUPPORT_POINTS", "DenseMatch", "Matcher", "SupportPoints"]
