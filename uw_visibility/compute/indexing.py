# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Conversion of a float to an index within bounds.

Compiled code does not check indices, and the conversion of NaN, infinity or a large float to an
integer is undefined: memory anywhere may be read or written. So all kernels convert by this
function (`test/test_structure.py` finds those that do not).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.compute.numba_import import register_jitable


@register_jitable
def index_of(value: Any, low: Any, high: Any) -> Any:
    """Integer part of a float, clipped to bounds; the lower bound for NaN.

    `low` and `high`, the smallest and largest index, are integers of 32 bits; ``low <= high``.
    Returns int32.
    """
    # False for NaN.
    if not value > low:
        return np.int32(low)
    return np.int32(high) if value >= high else np.int32(value)
