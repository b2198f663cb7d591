# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Check that the Huffman scans of a baseline JPEG contain all of its blocks.

If data end early, or a bit is wrong, decoders repeat the last block's brightness, or shift and tint
all later blocks, without an error: Pillow and OpenCV refuse only files without an end marker.
Transmission that loses a part of a frame causes such images with a correct end. The codes are
parsed without decoding (ITU-T T.81, F.2.2), and have to end where the data end.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.errors import InputError
from uw_visibility.images.encoded import BASELINE, FRAMES, MARKER, SCAN, TruncatedError, segments

HUFFMAN_TABLES, RESTART_INTERVAL = 0xC4, 0xDD
CODE_LENGTHS, LONGEST_CODE = 16, 16
# Returned by the kernel instead of the scan's end.
DAMAGED, CUT_OFF = -1, -2
# Largest number of bytes after a scan, not counting zeros: some cameras pad it.
MOST_PADDING = 16


def check_blocks(data: bytes) -> None:
    """Refuse a JPEG with missing blocks; only baseline JPEGs of 8 bit are checked.

    Raises `TruncatedError` if the data end early, `InputError` if they are damaged or left over.
    """
    reader = _ScanReader(data)
    try:
        for kind, content, at in segments(data):
            if kind != SCAN:
                reader.take(kind, content)
                continue
            if not reader.sequential:
                return
            end = reader.follow(content, at)
            if end == CUT_OFF:
                raise TruncatedError("its last rows are missing: it is truncated")
            if end == DAMAGED:
                raise InputError("it is damaged: it has an invalid code")
            marker = MARKER.search(data, end)
            over = data[end:] if marker is None else data[end : marker.start()]
            if len(over.strip(b"\0")) > MOST_PADDING:
                raise InputError("it is damaged: data are left over after its last block")
    except (struct.error, LookupError):
        # Decoders may accept such a file, for example one that omits standard tables.
        return


class _Component(NamedTuple):
    """Sampling of a colour component: blocks per unit (MCU), across and down."""

    across: int
    down: int


class _ScanReader:
    """Parses the scans of a JPEG, given its segments in order."""

    def __init__(self, data: bytes) -> None:
        self._data = np.frombuffer(data, np.uint8)
        self._tables: dict[int, NDArray[np.uint16]] = {}
        self._components: dict[int, _Component] = {}
        self._size = (0, 0)
        self._interval = 0
        self.sequential = False

    def take(self, kind: int, content: bytes) -> None:
        """Read a segment before a scan; struct.error or LookupError if it is damaged."""
        if kind in FRAMES:
            precision, height, width, count = struct.unpack_from(">BHHB", content)
            self.sequential = kind in BASELINE and precision == 8
            self._size = (width, height)
            self._components = {
                content[6 + 3 * k]: _Component(content[7 + 3 * k] >> 4, content[7 + 3 * k] & 15)
                for k in range(count)
            }
            if not all(0 < n <= 4 for component in self._components.values() for n in component):
                raise LookupError("a sampling factor is not within 1 to 4")
        elif kind == HUFFMAN_TABLES:
            at = 0
            while at < len(content):
                lengths = content[at + 1 : at + 1 + CODE_LENGTHS]
                end = at + 1 + CODE_LENGTHS + sum(lengths)
                symbols = content[at + 1 + CODE_LENGTHS : end]
                if len(lengths) < CODE_LENGTHS or len(symbols) < sum(lengths):
                    raise LookupError("a Huffman table is incomplete")
                self._tables[content[at]] = _lookup(bytes(lengths), bytes(symbols))
                at = end
        elif kind == RESTART_INTERVAL:
            (self._interval,) = struct.unpack_from(">H", content)

    def follow(self, content: bytes, at: int) -> int:
        """Parse a scan, given its segment's content and the position of its data.

        Returns the position of its end, or `DAMAGED` or `CUT_OFF`; LookupError if it refers to
        missing components or tables.
        """
        count = content[0]
        chosen = [(self._components[content[1 + 2 * k]], content[2 + 2 * k]) for k in range(count)]
        if not chosen:
            raise LookupError("a scan without components")
        blocks = np.array([c.across * c.down for c, _ in chosen], np.int64)
        coarse = np.stack([self._tables[tables >> 4] for _, tables in chosen])
        fine = np.stack([self._tables[0x10 | (tables & 15)] for _, tables in chosen])
        units = self._units([c for c, _ in chosen])
        if count == 1:
            blocks[:] = 1
        return int(_follow(self._data, at, units, self._interval, blocks, coarse, fine))

    def _units(self, chosen: list[_Component]) -> int:
        """Number of units (MCU) of a scan; for a single component, of its blocks."""
        across = max(c.across for c in self._components.values())
        down = max(c.down for c in self._components.values())
        width, height = self._size
        if len(chosen) > 1:
            return -(-width // (8 * across)) * -(-height // (8 * down))
        columns = -(-width * chosen[0].across // across)
        rows = -(-height * chosen[0].down // down)
        return -(-columns // 8) * -(-rows // 8)


# Cached, since cameras use the same tables for all images.
@lru_cache(maxsize=16)
def _lookup(lengths: bytes, symbols: bytes) -> NDArray[np.uint16]:
    """Length × 256 + symbol of the code at the start of any 16 bits, (65536,); 0 if invalid."""
    table = np.zeros(1 << LONGEST_CODE, np.uint16)
    code = at = 0
    for length, count in enumerate(lengths, 1):
        step = 1 << (LONGEST_CODE - length)
        for symbol in symbols[at : at + count]:
            table[code : code + step] = (length << 8) | symbol
            code += step
        at += count
    table.flags.writeable = False
    return table


@njit(nogil=True)
def _follow(
    data: Any, at: Any, units: Any, interval: Any, blocks: Any, coarse: Any, fine: Any
) -> Any:
    """Parse the codes of a scan; returns its end, or `DAMAGED` or `CUT_OFF`."""
    size = data.size
    buffer = np.uint64(0)
    held = np.int64(0)
    left = interval
    for _ in range(units):
        if interval > 0 and left == 0:
            # Bits up to the next byte are padding; a restart marker follows.
            held = np.int64(0)
            buffer = np.uint64(0)
            while at < size and data[at] == 0xFF and at + 1 < size and data[at + 1] == 0xFF:
                at += 1
            if at + 1 >= size:
                return CUT_OFF
            if data[at] != 0xFF or data[at + 1] < 0xD0 or data[at + 1] > 0xD7:
                return DAMAGED
            at += 2
            left = interval
        left -= 1
        for c in range(blocks.size):
            for _ in range(blocks[c]):
                k = np.int64(0)
                while k < 64:
                    while held <= 48 and at < size:
                        value = data[at]
                        if value == 0xFF:
                            if at + 1 >= size or data[at + 1] != 0:
                                break
                            at += 1
                        at += 1
                        buffer = (buffer << np.uint64(8)) | np.uint64(value)
                        held += 8
                    if held >= 16:
                        peek = (buffer >> np.uint64(held - 16)) & np.uint64(0xFFFF)
                    else:
                        peek = (buffer << np.uint64(16 - held)) & np.uint64(0xFFFF)
                    entry = coarse[c, np.int64(peek)] if k == 0 else fine[c, np.int64(peek)]
                    if entry == 0:
                        return CUT_OFF if held < 16 else DAMAGED
                    symbol = np.int64(entry & 0xFF)
                    bits = np.int64(symbol if k == 0 else symbol & 15)
                    if k == 0 and symbol > 15:
                        return DAMAGED
                    held -= np.int64(entry >> 8) + bits
                    if held < 0:
                        return CUT_OFF
                    if k == 0:
                        k = np.int64(1)
                    elif bits == 0 and symbol != 0xF0:
                        # The other coefficients of the block are zero.
                        k = np.int64(64)
                    else:
                        k += (symbol >> 4) + 1
                        if k > 64:
                            return DAMAGED
    return at - held // 8
