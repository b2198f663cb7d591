# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""JPEG chroma at its stored resolution, with the noise of its quantisation.

See `uw_visibility.images.jpeg_kernels` for what is done and why.
"""

from __future__ import annotations

import io
import math
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.files import read_regular
from uw_visibility.images import jpeg_kernels as kernels
from uw_visibility.images.arrays import Array, Image8
from uw_visibility.images.chroma import ChromaImage
from uw_visibility.images.encoded import JPEG, MOST_BYTES
from uw_visibility.images.jpeg_scan import check_blocks
from uw_visibility.images.pair import read_only

_BLOCK = 8


class _Layout(NamedTuple):
    """Chroma layout of a JPEG: subsampling and blocks."""

    scale: int  # the resolution at which it is read is the image's over this
    rows: int  # pixels of it to a block of colour
    columns: int
    exact: bool  # whether libjpeg decodes at that resolution without loss


# By how Pillow names them: 4:4:4, 4:2:2 and 4:2:0.
_LAYOUTS = {0: _Layout(1, 8, 8, True), 1: _Layout(2, 4, 8, False), 2: _Layout(2, 8, 8, True)}


class _File(NamedTuple):
    """Coefficients and quantisation tables of a JPEG."""

    layout: _Layout
    planes: NDArray[np.uint8]  # (h, w, 3): Y, Cb, Cr
    shape: tuple[int, int]  # rows and columns that show all of their pixels
    steps: list[Array]  # (8, 8) of Y, Cb, Cr


def jpeg_chroma(data: bytes) -> ChromaImage | None:
    """Read the chroma of a JPEG at its stored resolution.

    Parameters
    ----------
    data : bytes
        The file.

    Returns
    -------
    ChromaImage or None
        Of half of the image's resolution in 16 bit, or of all of it in 8 bit. None
        where the file holds no colour, or holds it in a form that is not known: what
        its pixels say has to do.
    """
    file = _read(data)
    if file is None:
        return None
    scale, rows, columns, exact = file.layout
    # Means of pixels are finer than their codes.
    code = 257 if scale > 1 else 1
    colour = np.empty((*file.shape, 3), np.uint16 if scale > 1 else np.uint8)
    # Steps of the transform over these blocks instead of over 8x8 pixels.
    size = math.sqrt(rows * columns) / _BLOCK
    steps = np.stack([size * table[:rows, :columns] for table in file.steps[1:]])
    steps = steps.astype(np.float32)
    missed, beyond = np.empty((2, 2, rows, columns))
    slope = np.empty(2)
    kernels.restore_colour(
        file.planes, exact, steps, _cosines(columns), _cosines(rows), colour, np.float32(code),
        missed, beyond, slope,
    )
    variances = [kernels.rounding_variance(missed[c], beyond[c], steps[c], True) for c in range(2)]
    noise = _noise(_light_variance(file), variances, slope)
    return ChromaImage(read_only(colour), scale, noise)


def file_chroma(path: str | Path, pixels: NDArray[Any]) -> ChromaImage | None:
    """Read the chroma of the file that an image was read from.

    Parameters
    ----------
    path : str or Path
        Of any format.
    pixels : ndarray
        ``(H, W, 3)`` or ``(H, W)``, what was read of it.

    Returns
    -------
    ChromaImage or None
        None where the pixels say all that there is.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    if pixels.ndim == 2:
        return None
    data = read_regular(path, MOST_BYTES, "image")
    return jpeg_chroma(data) if data.startswith(JPEG) else None


def warm_up_chroma(image: Image8) -> ChromaImage | None:
    """Compile the kernels of chroma, and return the chroma of a JPEG of an image."""
    from PIL import Image

    chroma = None
    for sampling in _LAYOUTS:
        file = io.BytesIO()
        Image.fromarray(image).save(file, "JPEG", quality=95, subsampling=sampling)
        check_blocks(file.getvalue())
        chroma = jpeg_chroma(file.getvalue())
    return chroma


def _read(data: bytes) -> _File | None:
    # Imported here, since images without loss need none of it.
    from PIL import Image, JpegImagePlugin

    try:
        image: Any = Image.open(io.BytesIO(data), formats=["JPEG"])
        layout = _LAYOUTS.get(JpegImagePlugin.get_sampling(image))
        if image.mode != "RGB" or layout is None or image.info.get("adobe_transform", 1) != 1:
            return None
        height, width = image.height // layout.scale, image.width // layout.scale
        if min(height, width) < 1:
            return None
        image.draft("YCbCr", (width, height) if layout.exact else image.size)
        planes = np.asarray(image)
        tables = [image.quantization[layer[3]] for layer in image.layer]
    except (OSError, SyntaxError, LookupError, Image.DecompressionBombError):
        # Damage, or a size beyond Pillow's limit, that OpenCV has decoded all the same.
        return None
    if not layout.exact:
        whole = planes[: layout.scale * height, : layout.scale * width]
        planes = np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))
    steps = [np.array(table, np.float64).reshape(_BLOCK, _BLOCK) for table in tables]
    return _File(layout, read_only(planes), (height, width), steps)


def _light_variance(file: _File) -> float:
    """Variance that rounding took from Y."""
    scale = file.layout.scale
    size = _BLOCK // scale
    steps = (file.steps[0][:size, :size] / scale).astype(np.float32)
    missed, beyond = np.empty((2, size, size))
    kernels.count_rounded(file.planes, steps, _cosines(size), missed, beyond)
    return kernels.rounding_variance(missed, beyond, steps, False)


def _noise(light: float, colour: list[float], slope: Array) -> Array:
    """Standard deviation of R, G, B, of which colour follows the errors of light."""
    of_cb = np.array([0.0, -kernels.GREEN_OF_CB, kernels.BLUE_OF_CB], np.float64)
    of_cr = np.array([kernels.RED_OF_CR, -kernels.GREEN_OF_CR, 0.0], np.float64)
    follows = 1.0 + of_cb * slope[0] + of_cr * slope[1]
    return np.asarray(np.sqrt(follows**2 * light + of_cb**2 * colour[0] + of_cr**2 * colour[1]))


@lru_cache(maxsize=4)
def _cosines(size: int) -> NDArray[np.float32]:
    """Cosine transform (DCT-II) as a matrix, orthonormal."""
    at = np.arange(size)
    matrix = np.cos(np.pi * (2 * at + 1) * at[:, np.newaxis] / (2 * size)) * math.sqrt(2 / size)
    matrix[0] /= math.sqrt(2)
    return np.ascontiguousarray(matrix, np.float32)
