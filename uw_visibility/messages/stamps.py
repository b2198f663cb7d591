# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stamps: in the headers of serialised messages, without decoding the rest, and as text."""

from __future__ import annotations

import struct
from decimal import Decimal

import numpy as np

from uw_visibility.errors import InputError

SECOND = 1_000_000_000
"""ns"""

CDR_STAMP = 4
"""Place of the header's stamp: CDR begins with four bytes, the second of which is the order of
bytes."""


def header_stamp(data: bytes, *, ros1: bool = False) -> int:
    """Read the header stamp, ns, of a serialised message whose type begins with a header.

    The format is CDR, or that of ROS 1, whose header begins with a counter.
    """
    try:
        if ros1:
            _, seconds, nanoseconds = struct.unpack_from("<III", data)
        else:
            seconds, nanoseconds = struct.unpack_from(stamp_format(data), data, CDR_STAMP)
    except (struct.error, IndexError) as error:
        raise InputError("a message ends before its stamp") from error
    return int(seconds * SECOND + nanoseconds)


def stamp_format(data: bytes) -> str:
    """Format of the header's stamp in CDR, for `struct`."""
    return ("<" if data[1] & 1 else ">") + "iI"


def seconds(nanoseconds: int) -> str:
    """Format a time, ns, in s with all digits."""
    return f"{Decimal(nanoseconds).scaleb(-9):f}"


def iso_time(nanoseconds: int) -> str:
    """Format a time, ns since the epoch, in UTC as ISO 8601 with all digits."""
    return f"{np.datetime64(nanoseconds, 'ns')}Z"
