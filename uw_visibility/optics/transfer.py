# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Transfer functions: lookup tables between code values and irradiance.

Transfers are ``"linear"`` or ``"srgb"`` (IEC 61966-2-1), types of images uint8 or uint16; anything
else raises an `InputError`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from uw_visibility.errors import InputError

# Lengths of encoding tables, by the largest code value: the steepest part of the sRGB curve, 12.92
# codes per linear code, has at least one step per code.
_ENCODE_STEPS = {255: 1 << 14, 65535: 1 << 20}


@lru_cache(maxsize=8)
def linear_table(transfer: str, dtype: DTypeLike) -> NDArray[np.float32]:
    """Lookup table from code value to irradiance 0..1, float32, read-only."""
    top = _largest_code(dtype)
    code = np.arange(top + 1, dtype=np.float64) / top
    table = decode(code, transfer).astype(np.float32)
    table.flags.writeable = False
    return table


def to_linear(image: NDArray[Any], transfer: str) -> NDArray[np.float32]:
    """Convert code values to irradiance 0..1, float32; float32 is returned as it is."""
    if image.dtype == np.float32:
        return image
    return np.take(linear_table(transfer, image.dtype), image)


def from_linear(
    irradiance: NDArray[np.floating], transfer: str, dtype: DTypeLike
) -> NDArray[np.integer]:
    """Convert irradiance to code values, rounded and clipped to 0..1; NaN becomes 0."""
    top = _largest_code(dtype)
    light = np.nan_to_num(np.clip(irradiance, 0.0, 1.0), nan=0.0)
    return (encode(light, transfer) * top + 0.5).astype(dtype)


@lru_cache(maxsize=8)
def encode_table(transfer: str, dtype: DTypeLike) -> NDArray[np.integer]:
    """Lookup table from irradiance, in equal steps over 0..1, to code value; read-only.

    For kernels: ``table[int(irradiance * (len(table) - 1) + 0.5)]``.
    """
    steps = _ENCODE_STEPS[_largest_code(dtype)]
    table = from_linear(np.linspace(0.0, 1.0, steps), transfer, dtype)
    table.flags.writeable = False
    return table


def decode(code: NDArray[np.float64], transfer: str) -> NDArray[np.float64]:
    """Irradiance of codes, both as parts of the largest."""
    if transfer == "linear":
        return code
    if transfer == "srgb":
        return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    raise InputError(f"camera.transfer is {transfer!r}: give linear or srgb")


def encode(light: NDArray[np.floating], transfer: str) -> NDArray[np.floating]:
    """Codes of irradiance, 0 or more, both as parts of the largest."""
    if transfer == "linear":
        return light
    if transfer == "srgb":
        curve = 1.055 * np.power(light, 1 / 2.4) - 0.055
        return np.where(light <= 0.0031308, light * 12.92, curve)
    raise InputError(f"camera.transfer is {transfer!r}: give linear or srgb")


def _largest_code(dtype: DTypeLike) -> int:
    if np.dtype(dtype) not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise InputError(f"images of type {np.dtype(dtype)} are not supported: give 8 or 16 bit")
    return int(np.iinfo(np.dtype(dtype)).max)
