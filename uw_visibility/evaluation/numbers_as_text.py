# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a study as text; what is not known is a dash."""

from __future__ import annotations

import math

UNKNOWN = "–"


def number(value: float | None, digits: int) -> str:
    """Return a number with so many decimals."""
    return UNKNOWN if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def percent(share: float) -> str:
    """Return a share in percent."""
    return UNKNOWN if not math.isfinite(share) else f"{100 * share:.0f}"
