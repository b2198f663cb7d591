# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Encoded images: header and completeness are checked before anything is decoded.

A few bytes can claim any size, and a decoder takes the memory for it first. Decoders fill what is
missing or damaged with grey or with wrong pixels, and report nothing.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Iterator
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
SCAN, END = 0xDA, b"\xff\xd9"
BASELINE, PROGRESSIVE = (0xC0, 0xC1), 0xC2
COEFFICIENTS = 64
# What ends the codes of a scan: among them 0xFF stands before zeros and restarts alone.
MARKER = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")

# TIFF 6.0: types SHORT and LONG, and tags of sizes.
TIFF_TYPES = {3: "H", 4: "I"}
TIFF_WIDTH, TIFF_HEIGHT, TIFF_TILE_WIDTH, TIFF_TILE_HEIGHT = 256, 257, 322, 323


class TruncatedError(InputError):
    """The image ends before its last row."""


class Header(NamedTuple):
    """Width and height of an encoded image, px."""

    width: int
    height: int


def read_header(data: bytes) -> Header:
    """Read the size of a PNG, JPEG, TIFF or binary PNM, and check that it is complete.

    `TruncatedError` where its end is missing; refused beyond `MOST_PIXELS`.
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


def decode(data: bytes) -> NDArray[Any]:
    """Decode an image as it is stored, (H, W) or (H, W, C): depth and channels are not converted.

    Channels are in OpenCV's order, blue first. Refused as by `read_header`, and if it cannot be
    decoded, codes of a JPEG are missing or left over, or it has neither 8 nor 16 bit per channel.
    """
    header = read_header(data)
    image: NDArray[Any] | None = None
    if data.startswith(JPEG):
        # Imported here, since images without loss need no compiled code.
        from uw_visibility.images.jpeg_scan import check_blocks

        check_blocks(data)
        image = _decode_jpeg(data)
    try:
        if image is None:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise InputError("it is damaged, and cannot be decoded") from error
    if image is None or image.shape[:2] != (header.height, header.width):
        raise InputError("it is damaged, and cannot be decoded")
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"it holds {image.dtype}: give 8 or 16 bit per channel")
    return image


def _decode_jpeg(data: bytes) -> NDArray[np.uint8] | None:
    """Decode a grey or RGB image by Pillow, to the same pixels as OpenCV; None for all others.

    OpenCV lets the codec write what it thinks of the data to standard error.
    """
    # Imported here, since images without loss need none of it.
    from PIL import Image

    try:
        image = Image.open(io.BytesIO(data), formats=["JPEG"])
    except (OSError, Image.DecompressionBombError):
        return None
    if image.mode not in ("L", "RGB"):
        return None
    try:
        pixels = np.asarray(image)
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError("it is damaged, and cannot be decoded") from error
    return pixels if image.mode == "L" else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)


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


def segments(data: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Walk the segments of a JPEG up to its end (ITU-T T.81, annex B).

    Yields each one's marker and content, and where what follows it begins, as a scan's codes do.
    """
    at, scanned = 2, False
    while at + 4 <= len(data):
        if scanned:
            # Behind codes some encoders fill up.
            marker = MARKER.search(data, at)
            if marker is None:
                return
            at = marker.start()
        elif data[at] != 0xFF:
            raise InputError("it is damaged: a marker is missing")
        kind = data[at + 1]
        if kind == 0xFF or kind in ALONE:
            # A marker may be preceded by any number of 0xFF.
            at += 1 if kind == 0xFF else 2
            continue
        if kind == END[1]:
            return
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        content = data[at + 4 : at + 2 + length]
        at += 2 + length
        scanned |= kind == SCAN
        yield kind, content, at


def _read_jpeg(data: bytes) -> Header:
    """Read the size of a JPEG, and refuse one without an end, or with parts of scans missing.

    A decoder takes what is there for a coarse image and smooths over the rest (T.81, G.1.1.1.1).
    """
    header: Header | None = None
    progressive = False
    scans = last = 0
    # By component, to how many bits less than all each coefficient is known.
    missing: dict[int, list[int]] = {}
    for kind, content, at in segments(data):
        if kind == SCAN:
            scans, last = scans + 1, at
            if scans > MOST_SCANS:
                raise InputError(f"it has more than {MOST_SCANS} scans")
            if content and len(content) >= 4 + 2 * content[0]:
                _take_scan(missing, content, progressive)
        elif kind in FRAMES and scans == 0 and len(content) >= 6:
            height, width = struct.unpack_from(">HH", content, 1)
            header = Header(width, height)
            if kind not in (*BASELINE, PROGRESSIVE):
                # Of arithmetic codes no decoder tells whether they are damaged.
                raise InputError("it is no baseline or progressive JPEG, as cameras write")
            progressive = kind == PROGRESSIVE
            missing = {component: [COEFFICIENTS] * COEFFICIENTS for component in content[6::3]}
    if scans == 0:
        raise TruncatedError("it has no image in it: it is truncated or damaged")
    # A preview in one of the segments before the scans has an end of its own.
    if data.rfind(END) < last:
        raise TruncatedError("it has no end: it is truncated")
    if any(map(any, missing.values())):
        raise TruncatedError("scans of it are missing: it is truncated")
    if header is None:
        raise InputError("it is damaged: it does not tell its size")
    return header


def _take_scan(missing: dict[int, list[int]], content: bytes, progressive: bool) -> None:
    """Note the bits of coefficients that a scan brings, by its segment's content."""
    band = slice(content[-3], content[-2] + 1) if progressive else slice(None)
    before, after = (content[-1] >> 4, content[-1] & 15) if progressive else (0, 0)
    for component in content[1 : 1 + 2 * content[0] : 2]:
        bits = missing.get(component, [])
        # A scan that refines rests on the one before it.
        bits[band] = [after if before in (0, k) else k for k in bits[band]]


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
