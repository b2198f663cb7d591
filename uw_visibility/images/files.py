# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Images and maps as files: PNG, JPEG and TIFF in, PNG and PFM out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError

# How files of a format begin, and what stands at their end.
ENDS = ((b"\x89PNG\r\n\x1a\n", b"IEND"), (b"\xff\xd8\xff", b"\xff\xd9"))


def read_image(path: str | Path) -> NDArray[Any]:
    """Read an image as it is stored: depth and channels are not converted.

    Parameters
    ----------
    path : str or Path
        A file of any format that OpenCV reads.

    Returns
    -------
    ndarray, (H, W) or (H, W, 3), uint8 or uint16
        The image, RGB where it has colour; a transparency channel is left out.

    Raises
    ------
    InputError
        If the file cannot be read, is not an image, or has neither 8 nor 16
        bit per channel.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"cannot read image {path}: {error.strerror}") from error
    image = None
    if content and not _is_cut_off(content):
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise InputError(f"{path} is not a readable image: give a complete PNG, JPEG or TIFF file")
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"image {path} holds {image.dtype}: give 8 or 16 bit per channel")
    if image.ndim == 3:
        image = image[:, :, 2::-1]
    return np.ascontiguousarray(image)


def write_png(path: str | Path, image: NDArray[Any]) -> None:
    """Write an image without loss.

    Parameters
    ----------
    path : str or Path
        The file.
    image : ndarray, (H, W) or (H, W, 3), uint8 or uint16
        Grey or RGB.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    stored = image if image.ndim == 2 else image[:, :, ::-1]
    _, content = cv2.imencode(".png", np.ascontiguousarray(stored))
    _write(path, content.tobytes())


def write_pfm(path: str | Path, values: NDArray[np.float32]) -> None:
    """Write a map as portable float map.

    Parameters
    ----------
    path : str or Path
        The file.
    values : ndarray, (H, W) float32
        The map; stored little endian, the bottom row first, as the format asks.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    height, width = values.shape
    header = f"Pf\n{width} {height}\n-1.0\n".encode("ascii")
    _write(path, header + values[::-1].astype("<f4").tobytes())


def _is_cut_off(content: bytes) -> bool:
    """Tell a PNG or JPEG without its end, of which OpenCV may make up the missing rows."""
    return any(content.startswith(start) and end not in content for start, end in ENDS)


def _write(path: str | Path, content: bytes) -> None:
    try:
        Path(path).write_bytes(content)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from error
