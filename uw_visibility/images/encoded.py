# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Encoded images: header and completeness are checked before anything is decoded.

A few bytes can claim any size, and a decoder takes the memory for it first. What ends
early, decoders fill with grey without a word.
"""

from __future__ import annotations

import re
import struct
import zlib
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError

JPEG, PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
TIFF = (b"II*\0", b"MM\0*")
PNM = re.compile(rb"P[56](?:\s+#[^\n]*)*\s+(\d{1,9})(?:\s+#[^\n]*)*\s+(\d{1,9})\s")

MOST_PIXELS = 100_000_000
"""Larger images are refused: no camera on a vehicle has as many pixels."""
MOST_BYTES = 8 * MOST_PIXELS
"""Bytes of a file: four channels of 16 bit, not compressed."""
# A progressive JPEG has some ten scans, and each costs the time of an image.
MOST_SCANS = 100

# ITU-T T.81, table B.1: markers of a frame, and those that stand alone.
FRAMES = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
ALONE = frozenset({0x01, *range(0xD0, 0xD8)})
SCAN, END = b"\xff\xda", b"\xff\xd9"
BLOCK = 8

# TIFF 6.0: types SHORT and LONG, and tags of sizes.
TIFF_TYPES = {3: "H", 4: "I"}
TIFF_WIDTH, TIFF_HEIGHT, TIFF_TILE_WIDTH, TIFF_TILE_HEIGHT = 256, 257, 322, 323


class TruncatedError(InputError):
    """The image ends before its last row."""


class Header(NamedTuple):
    """Header of an encoded image: size, depth and completeness.

    Attributes
    ----------
    width, height : int
        Pixels.
    """

    width: int
    height: int


def read_header(data: bytes) -> Header:
    """Read the size of a PNG, JPEG, TIFF or binary PNM, and whether it is all there.

    Parameters
    ----------
    data : bytes
        The encoded image.

    Returns
    -------
    Header

    Raises
    ------
    InputError
        If it is none of these, is damaged, or has more than `MOST_PIXELS`;
        `TruncatedError` where its end is missing.
    """
    if data.startswith(PNG):
        header = _read_png(data)
    elif data.startswith(JPEG):
        header = _read_jpeg(data)
    elif data.startswith(TIFF):
        header = _read_tiff(data)
    elif (match := PNM.match(data)) is not None:
        header = Header(int(match[1]), int(match[2]))
    else:
        raise InputError("it is neither PNG, JPEG nor TIFF")
    if header.width < 1 or header.height < 1:
        raise InputError(f"it is damaged: it claims {header.width}x{header.height} pixels")
    if header.width * header.height > MOST_PIXELS:
        raise InputError(
            f"it claims {header.width}x{header.height} pixels, more than {MOST_PIXELS}"
        )
    return header


def decode(data: bytes, *, thorough: bool = False) -> NDArray[Any]:
    """Decode an image as it is stored: depth and channels are not converted.

    Parameters
    ----------
    data : bytes
        The encoded image.
    thorough : bool
        Whether the codes of a JPEG are followed in any case, which takes as long as
        decoding does; else where its end looks as if they were missing.

    Returns
    -------
    ndarray, (H, W) or (H, W, C), uint8 or uint16
        Channels in OpenCV's order, blue first.

    Raises
    ------
    InputError
        As `read_header`, and if it cannot be decoded or has neither 8 nor 16 bit
        per channel.
    """
    header = read_header(data)
    if thorough and data.startswith(JPEG):
        _check_blocks(data)
    try:
        image: NDArray[Any] | None = cv2.imdecode(
            np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED
        )
    except cv2.error as error:
        raise InputError("it is damaged, and cannot be decoded") from error
    if image is None or image.shape[:2] != (header.height, header.width):
        raise InputError("it is damaged, and cannot be decoded")
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"it holds {image.dtype}: give 8 or 16 bit per channel")
    if not thorough and data.startswith(JPEG):
        # Blocks that are missing are decoded as one colour.
        corner = image[-BLOCK:, -BLOCK:]
        if (corner == corner[-1, -1]).all():
            _check_blocks(data)
    return image


def _check_blocks(data: bytes) -> None:
    # Imported here, since images without loss need no compiled code.
    from uw_visibility.images.jpeg_scan import check_blocks

    check_blocks(data)


def _read_png(data: bytes) -> Header:
    """Walk the chunks, of which each has a checksum (W3C PNG, section 5)."""
    view = memoryview(data)
    header: Header | None = None
    at = len(PNG)
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            break
        (checksum,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(view[at + 4 : end - 4]) != checksum:
            raise InputError("it is damaged: a checksum differs")
        if header is None:
            if kind != b"IHDR" or length != 13:
                raise InputError("it is damaged: it does not begin with its size")
            header = Header(*struct.unpack_from(">II", data, at + 8))
        if kind == b"IEND":
            return header
        at = end
    raise TruncatedError("it has no end: it is truncated")


def _read_jpeg(data: bytes) -> Header:
    """Walk the segments up to the first scan (ITU-T T.81, annex B)."""
    header: Header | None = None
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            raise InputError("it is damaged: a marker is missing")
        kind = data[at + 1]
        if kind == 0xFF or kind in ALONE:
            # A marker may be preceded by any number of 0xFF.
            at += 1 if kind == 0xFF else 2
            continue
        if kind == END[1]:
            break
        (length,) = struct.unpack_from(">H", data, at + 2)
        if kind in FRAMES and length >= 8 and at + 9 <= len(data):
            height, width = struct.unpack_from(">HH", data, at + 5)
            header = Header(width, height)
        if kind == SCAN[1]:
            _check_scans(data, at)
            if header is None:
                raise InputError("it is damaged: it does not tell its size")
            return header
        at += 2 + length
    raise TruncatedError("it has no image in it: it is truncated or damaged")


def _check_scans(data: bytes, first: int) -> None:
    # In scans 0xFF never stands before a code of a marker, and a preview in one of the
    # segments before them has an end of its own.
    last = data.rfind(SCAN, first)
    if data.rfind(END) < last:
        raise TruncatedError("it has no end: it is truncated")
    if last > first and data.count(SCAN, first) > MOST_SCANS:
        raise InputError(f"it has more than {MOST_SCANS} scans")


def _read_tiff(data: bytes) -> Header:
    order = "<" if data[:2] == b"II" else ">"
    tags: dict[int, int] = {}
    try:
        (at,) = struct.unpack_from(f"{order}I", data, 4)
        (count,) = struct.unpack_from(f"{order}H", data, at)
        for entry in range(count):
            tag, kind, number = struct.unpack_from(f"{order}HHI", data, at + 2 + 12 * entry)
            if kind in TIFF_TYPES and number == 1:
                (tags[tag],) = struct.unpack_from(
                    f"{order}{TIFF_TYPES[kind]}", data, at + 10 + 12 * entry
                )
        header = Header(tags[TIFF_WIDTH], tags[TIFF_HEIGHT])
    except (struct.error, KeyError) as error:
        raise TruncatedError("it does not tell its size: it is truncated or damaged") from error
    # Decoders take memory for a tile, which need not be smaller than the image.
    if tags.get(TIFF_TILE_WIDTH, 1) * tags.get(TIFF_TILE_HEIGHT, 1) > MOST_PIXELS:
        raise InputError(f"it claims tiles of more than {MOST_PIXELS} pixels")
    return header
