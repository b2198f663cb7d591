# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Decompression in recordings, with the libraries that rosbags brings."""

from __future__ import annotations

from pathlib import Path

# What rosbags itself unpacks with, so that nothing else need be installed.
from rosbags.rosbag2.reader import zstd
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

BLOCK = 1 << 20


class PackingError(Exception):
    """Packed data are damaged, or packed in an unknown way."""


def unpack(data: bytes, compression: str, size: int = 0) -> bytes:
    """Decompress data.

    Parameters
    ----------
    data : bytes
        Packed data.
    compression : str
        "zstd", "lz4", or "" for none.
    size : int
        Length of the unpacked data, where it is known.

    Returns
    -------
    bytes

    Raises
    ------
    PackingError
        If that cannot be done.
    """
    try:
        return bytes(DECOMPRESSORS[compression](data, size))
    except Exception as error:
        # Each library has errors of its own.
        raise PackingError(f"{compression}: {error}") from error


def unpack_file(source: Path, target: Path) -> str:
    """Decompress a file of Zstandard as far as it goes.

    Parameters
    ----------
    source, target : Path
        Packed file, and the file to write.

    Returns
    -------
    str
        Why it ended early; empty where it did not.
    """
    with source.open("rb") as packed, target.open("wb") as unpacked:
        try:
            with zstd.open(packed, "rb") as stream:
                while block := stream.read(BLOCK):
                    unpacked.write(block)
        except (EOFError, zstd.ZstdError) as error:
            return f"{source.name} is damaged ({error}): read as far as it goes"
    return ""
