# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Encoded images: size, and completeness of PNG and JPEG, are checked before decoding.

A short file can declare any size, for which decoders allocate memory first. Decoders fill missing
or damaged parts with grey or wrong pixels, without an error.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError

JPEG, PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
TIFF = (b"II*\0", b"MM\0*")
# Width, height and largest code; a comment ends with its line.
PNM = re.compile(rb"P[56]" + 3 * rb"\s+(?:#[^\n]*\n\s*)*(\d{1,9})" + rb"\s")
PNM_CODES = (0xFF, 0xFFFF)

MOST_PIXELS = 100_000_000
"""Larger images are refused: no camera on a vehicle has as many pixels."""
MOST_BYTES = 8 * MOST_PIXELS
"""Largest size of a file, bytes: four channels of 16 bit, not compressed."""
# A progressive JPEG has some ten scans, and each takes as long to decode as an image.
MOST_SCANS = 100

# ITU-T T.81, table B.1: start-of-frame markers, and markers without a segment.
FRAMES = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
ALONE = frozenset({0x01, *range(0xD0, 0xD8)})
SCAN, END = 0xDA, b"\xff\xd9"
BASELINE, PROGRESSIVE = (0xC0, 0xC1), 0xC2
COEFFICIENTS = 64
# Marker that ends a scan's data, in which 0xFF precedes only zeros and restart markers.
MARKER = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")

# TIFF 6.0: types SHORT and LONG, and tags.
TIFF_TYPES = {3: "H", 4: "I"}
TIFF_WIDTH, TIFF_HEIGHT, TIFF_TILE_WIDTH, TIFF_TILE_HEIGHT = 256, 257, 322, 323
TIFF_MEANING, TIFF_ORIENTATION = 262, 274
TIFF_WHITE_IS_ZERO, TIFF_UPRIGHT = 0, 1


class TruncatedError(InputError):
    """The encoded image is incomplete."""


def read_size(data: bytes) -> tuple[int, int]:
    """Read width and height, px, of a PNG, JPEG, TIFF or binary PNM.

    Raises `TruncatedError` if a PNG or JPEG is not complete, `InputError` if the image is damaged
    or beyond `MOST_PIXELS`.
    """
    if data.startswith(PNG):
        width, height = _read_png(data)
    elif data.startswith(JPEG):
        width, height = _read_jpeg(data)
    elif data.startswith(TIFF):
        width, height = _read_tiff(data)
    elif (match := PNM.match(data)) is not None:
        width, height, largest = map(int, match.groups())
        if largest not in PNM_CODES:
            # Decoders ignore it, and return codes that would seem to be dark.
            raise InputError(f"its largest code is {largest}, not that of 8 or 16 bit")
    else:
        raise InputError("it is neither PNG, JPEG nor TIFF")
    if width < 1 or height < 1:
        raise InputError(f"it is damaged: it declares {width}x{height} pixels")
    if width * height > MOST_PIXELS:
        raise InputError(f"it declares {width}x{height} pixels, more than {MOST_PIXELS}")
    return width, height


def decode(data: bytes) -> NDArray[Any]:
    """Decode an image as it is stored, (H, W) or (H, W, C): depth and channels are not converted.

    Channels are in OpenCV's order, blue first. Raises as `read_size`, and if decoding fails, data
    of a JPEG are missing or left over, or the image has neither 8 nor 16 bit per channel.
    """
    width, height = read_size(data)
    image: NDArray[Any] | None = None
    if data.startswith(JPEG):
        # Imported here, since lossless images need no compiled code.
        from uw_visibility.images.jpeg_scan import check_blocks

        check_blocks(data)
        image = _decode_jpeg(data)
    try:
        if image is None:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise InputError("it is damaged, and cannot be decoded") from error
    if image is None or image.shape[:2] != (height, width):
        raise InputError("it is damaged, and cannot be decoded")
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"it has values of {image.dtype}, not of 8 or 16 bit")
    return image


def _decode_jpeg(data: bytes) -> NDArray[np.uint8] | None:
    """Decode a grey or RGB image by Pillow, to the same pixels as OpenCV; None for all others.

    With OpenCV the codec would print warnings to standard error.
    """
    # Imported here, since lossless images do not need it.
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


def _read_png(data: bytes) -> tuple[int, int]:
    """Read the size of a PNG, and check its chunks by their checksums (W3C PNG, section 5)."""
    view = memoryview(data)
    size: tuple[int, int] | None = None
    at = len(PNG)
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            break
        (checksum,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(view[at + 4 : end - 4]) != checksum:
            raise InputError("it is damaged: a checksum differs")
        if size is None:
            if kind != b"IHDR" or length != 13:
                raise InputError("it is damaged: its first chunk is not a header")
            size = struct.unpack_from(">II", data, at + 8)
        if kind == b"IEND":
            return size
        at = end
    raise TruncatedError("its end is missing: it is truncated")


def segments(data: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Iterate over the segments of a JPEG up to its end (ITU-T T.81, annex B).

    Yields marker, content, and the position after the segment, where the data of a scan begin.
    """
    at, scanned = 2, False
    while at + 4 <= len(data):
        if scanned:
            # Skip the scan's data, and padding by some encoders.
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


def _read_jpeg(data: bytes) -> tuple[int, int]:
    """Read the size of a JPEG; refuse one without an end or with missing scans.

    Without some scans decoders would return a coarse, smoothed image (T.81, G.1.1.1.1).
    """
    size: tuple[int, int] | None = None
    progressive = False
    scans = last = 0
    # Number of missing low-order bits of each coefficient, by component.
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
            size = width, height
            if kind not in (*BASELINE, PROGRESSIVE):
                # Decoders do not detect damage of arithmetic codes.
                raise InputError("it is a JPEG that is neither baseline nor progressive")
            progressive = kind == PROGRESSIVE
            missing = {component: [COEFFICIENTS] * COEFFICIENTS for component in content[6::3]}
    if scans == 0:
        raise TruncatedError("it has no image data: it is truncated or damaged")
    # A preview in a segment before the scans has an end marker, too.
    if data.rfind(END) < last:
        raise TruncatedError("its end is missing: it is truncated")
    if any(map(any, missing.values())):
        raise TruncatedError("some of its scans are missing: it is truncated")
    if size is None:
        raise InputError("it is damaged: its size is missing")
    return size


def _take_scan(missing: dict[int, list[int]], content: bytes, progressive: bool) -> None:
    """Update the missing bits of coefficients by the content of a scan's segment."""
    band = slice(content[-3], content[-2] + 1) if progressive else slice(None)
    before, after = (content[-1] >> 4, content[-1] & 15) if progressive else (0, 0)
    for component in content[1 : 1 + 2 * content[0] : 2]:
        bits = missing.get(component, [])
        # A refinement counts only if the scan that it refines was there.
        bits[band] = [after if before in (0, k) else k for k in bits[band]]


def _read_tiff(data: bytes) -> tuple[int, int]:
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
        size = tags[TIFF_WIDTH], tags[TIFF_HEIGHT]
    except (struct.error, KeyError) as error:
        raise TruncatedError("its size is missing: it is truncated or damaged") from error
    # Decoders allocate memory for a tile, which may be larger than the image.
    if tags.get(TIFF_TILE_WIDTH, 1) * tags.get(TIFF_TILE_HEIGHT, 1) > MOST_PIXELS:
        raise InputError(f"it declares tiles of more than {MOST_PIXELS} pixels")
    # Decoders turn some images and not others, and invert 8 bit but not 16.
    if (orientation := tags.get(TIFF_ORIENTATION, TIFF_UPRIGHT)) != TIFF_UPRIGHT:
        raise InputError(f"it is stored with orientation {orientation}, not upright (1)")
    if tags.get(TIFF_MEANING) == TIFF_WHITE_IS_ZERO:
        raise InputError("its 0 is white, not black")
    return size
