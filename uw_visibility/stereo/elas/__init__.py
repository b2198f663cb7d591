# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""ELAS, from its publication (Geiger, Roser and Urtasun, ACCV 2010)."""

from uw_visibility.stereo.elas.matcher import DenseMatch, Matcher
from uw_visibility.stereo.elas.support import SupportPoints

__all__ = ["DenseMatch", "Matcher", "SupportPoints"]
