# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Type aliases of arrays; shapes and units that are not given here are in docstrings."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[Any]
"""``(H, W, 3)`` RGB or ``(H, W)`` grey; uint8 or uint16 code values."""

Image8: TypeAlias = NDArray[np.uint8]
"""``(H, W, 3)`` RGB or ``(H, W)`` grey; uint8 code values."""

Mask: TypeAlias = NDArray[np.bool_]
"""bool, ``(H, W)`` unless stated otherwise."""

RangeMap: TypeAlias = NDArray[np.float32]
"""``(H, W)`` float32, Euclidean distance along the line of sight, m; NaN where unknown."""

DisparityMap: TypeAlias = NDArray[np.float32]
"""``(H, W)`` float32, left-referenced, px; NaN where unmatched."""

Points: TypeAlias = NDArray[np.float32]
"""``(N, 3)`` float32: column, row and disparity, px."""

PerChannel: TypeAlias = NDArray[np.float64]
"""``(3,)`` float64 for R, G, B, or ``(1,)`` for grey."""

Map: TypeAlias = NDArray[np.float32]
"""float32 per pixel."""

Array: TypeAlias = NDArray[np.float64]
"""float64 of any shape."""
