# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Decompression in recordings with the libraries of rosbags, up to a limit."""

from __future__ import annotations

import bz2
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import rosbags.rosbag1.reader
import rosbags.rosbag2.storage_mcap

# The library that rosbags uses: no other dependency.
from rosbags.rosbag2.reader import zstd

from uw_visibility.replay.bags.source import MOST_AT_ONCE

BLOCK = 1 << 16
# Larger ratios are attacks that fill the disk: even black images with some noise compress only
# by ten.
LARGEST_RATIO, LEAST_FREE = 200, 1 << 30

DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "zstd": zstd.ZstdDecompressor,
    "lz4": lz4.frame.LZ4FrameDecompressor,
    "bz2": bz2.BZ2Decompressor,
}

# First bytes of data compressed by Zstandard.
ZSTD = b"\x28\xb5\x2f\xfd"


class PackingError(Exception):
    """Compressed data are damaged, or of an unknown format."""


def unpack(data: bytes, compression: str, most: int = MOST_AT_ONCE) -> bytes:
    """Decompress data, up to `most` bytes, of a compression: zstd, lz4, bz2, or "" or none.

    Raises `PackingError` if the data cannot be decompressed completely.
    """
    unpacked, problem = unpack_part(data, compression, most)
    if problem:
        raise PackingError(f"{compression}: {problem}")
    return unpacked


def unpack_part(data: bytes, compression: str, most: int = MOST_AT_ONCE) -> tuple[bytes, str]:
    """Decompress data as far as possible; for parameters see `unpack`.

    Returns the decompressed data, and the reason if they end early; empty if complete.
    """
    if compression in ("", "none"):
        return data, "" if len(data) <= most else f"more than {most} bytes"
    if compression not in DECOMPRESSORS:
        return b"", "unknown compression"
    parts: list[bytes] = []
    size = 0
    rest = data
    try:
        while rest:
            stream = DECOMPRESSORS[compression]()
            while not stream.eof:
                part = stream.decompress(rest, max_length=BLOCK)
                rest = b""
                parts.append(part)
                size += len(part)
                if size > most:
                    return b"".join(parts)[:most], f"more than {most} bytes"
                if not part and stream.needs_input:
                    return b"".join(parts), "it is cut off"
            # Several frames may follow one another.
            rest = stream.unused_data or b""
    except Exception as error:
        # Each library has its own errors.
        return b"".join(parts), str(error)
    return b"".join(parts), ""


def unpack_file(source: Path, target: Path) -> str:
    """Decompress a Zstandard file as far as possible; returns the reason if it ends early."""
    packed_size = source.stat().st_size
    most = min(
        max(LARGEST_RATIO * packed_size, MOST_AT_ONCE),
        shutil.disk_usage(target.parent).free - LEAST_FREE,
    )
    size = 0
    with source.open("rb") as packed, target.open("wb") as unpacked:
        try:
            with zstd.open(packed, "rb") as stream:
                while block := stream.read(MOST_AT_ONCE >> 8):
                    size += len(block)
                    if size > most:
                        return f"{source.name} unpacks to more than {most} bytes: read up to this"
                    unpacked.write(block)
        except (EOFError, zstd.ZstdError, OSError) as error:
            return f"{source.name} is damaged ({error}): read up to the damage"
    return ""


def _limit_rosbags() -> None:
    """Limit the decompression of rosbags, which is unlimited by default."""
    ros2, ros1 = rosbags.rosbag2.storage_mcap.DECOMPRESSORS, rosbags.rosbag1.reader.decompressors
    for name in ("zstd", "lz4"):
        # The stated size cannot be trusted.
        ros2[name] = lambda data, size, name=name: unpack(data, name, min(size, MOST_AT_ONCE))
    for name in ("bz2", "lz4"):
        ros1[name] = lambda data, name=name: unpack(data, name)


_limit_rosbags()
