# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""JPEG chroma at its stored resolution, restored within its quantisation intervals, with its noise.

The file holds each coefficient of a block's cosine transform (ITU-T T.81) rounded to a multiple of
its step: the true value is within half a step. Steps of chroma are coarse, so that most of its
detail is rounded to 0, while luma keeps its detail. After plain decoding a dark speck is darker by
the same amount in all channels, also in one that water attenuates strongly: red would be below
black. But light and shade change chroma in proportion to luma, and the coarse coefficients of a
block show the slope. Each coefficient is therefore predicted from luma within the file's interval.
"""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from uw_visibility.config.files import read_regular
from uw_visibility.images.arrays import Array, Image8
from uw_visibility.images.cells import means
from uw_visibility.images.chroma import ChromaImage
from uw_visibility.images.encoded import JPEG, MOST_BYTES
from uw_visibility.images.jpeg_scan import check_blocks
from uw_visibility.images.pair import read_only

_BLOCK = 8


class _Layout(NamedTuple):
    """Chroma layout of a JPEG: subsampling and blocks."""

    scale: int  # the image's resolution over that at which chroma is read
    rows: int  # size of a chroma block at the latter resolution
    columns: int
    exact: bool  # whether libjpeg decodes at that resolution without loss


# By Pillow's code: 4:4:4, 4:2:2 and 4:2:0.
_LAYOUTS = {0: _Layout(1, 8, 8, True), 1: _Layout(2, 4, 8, False), 2: _Layout(2, 8, 8, True)}


class _File(NamedTuple):
    """Coefficients and quantisation tables of a JPEG."""

    layout: _Layout
    planes: NDArray[Any]  # (h, w, 3): Y, Cb, Cr, uint8, or float32 where they are means
    shape: tuple[int, int]  # rows and columns, without incomplete ones at the border
    steps: list[Array]  # (8, 8) of Y, Cb, Cr


# Variance of a chroma coefficient that luma does not predict.
UNRELATED_VARIANCE = 0.5
# Iterations of the prediction within intervals and of its slope.
ROUNDS = 3
# Iterations of the estimate of the prediction errors' scale.
SCALE_ROUNDS = 30
# Every so many rows of blocks are enough for statistics.
STRIDE = 4
# Least scale of prediction errors, in steps.
LEAST_SCALE = 1.0 / 300.0
NEUTRAL = np.float32(128.0)
# Matrix from Y, Cb, Cr to R, G, B (ITU-T T.871).
TO_RGB = np.array([[1.0, 0.0, 1.402], [1.0, -0.344136, -0.714136], [1.0, 1.772, 0.0]])

Blocks = NDArray[np.float32]
"""(tall, wide, rows, columns): blocks of an image, or the coefficients of their transforms."""


def jpeg_chroma(data: bytes) -> ChromaImage | None:
    """Read the chroma of a JPEG at its stored resolution.

    It has half of the image's resolution and 16 bit, or full resolution and 8 bit. None if the file
    has no colour or an unsupported layout, so that the image's pixels are to be used.
    """
    file = _read(data)
    if file is None:
        return None
    scale, rows, columns, exact = file.layout
    # Factor from steps of 8x8 blocks to those of blocks of this size, in an orthonormal transform.
    size = math.sqrt(rows * columns) / _BLOCK
    brightness = _blocks(file.planes[..., 0], rows, columns)
    light = _transform(brightness)
    planes, variances, slopes = [brightness], [], []
    for plane in (1, 2):
        steps = (size * file.steps[plane][:rows, :columns]).astype(np.float32)
        colour = _transform(_blocks(file.planes[..., plane], rows, columns) - NEUTRAL)
        restored, variance, slope = _restore(light, colour, steps, exact)
        planes.append(restored)
        variances.append(variance)
        slopes.append(slope)
    # Means of pixels have finer steps than 8 bit.
    code, dtype = (257, np.uint16) if scale > 1 else (1, np.uint8)
    joined = cv2.merge([each.swapaxes(1, 2).reshape(
        each.shape[0] * rows, each.shape[1] * columns) for each in planes])
    codes = np.clip(
        cv2.transform(joined[: file.shape[0], : file.shape[1]], code * TO_RGB), 0, 255 * code)
    # Errors of luma also enter predicted chroma, by the slopes.
    of_colour = TO_RGB[:, 1:]
    noise = np.sqrt(
        (1.0 + of_colour @ np.array(slopes)) ** 2 * _light_variance(file)
        + of_colour**2 @ np.array(variances))
    return ChromaImage(read_only((codes + np.float32(0.5)).astype(dtype)), scale, noise)


def file_chroma(path: str | Path, pixels: NDArray[Any]) -> ChromaImage | None:
    """Read the chroma of the file, of any format, that an image (H, W, 3) or (H, W) was read from.

    None where the pixels are to be used instead, see `jpeg_chroma`. Raises `InputError` if the file
    cannot be read.
    """
    if pixels.ndim == 2:
        return None
    data = read_regular(path, MOST_BYTES, "image")
    return jpeg_chroma(data) if data.startswith(JPEG) else None


def warm_up_chroma(image: Image8) -> ChromaImage | None:
    """Compile the check of JPEG codes, and return the chroma of an image encoded as JPEG."""
    from PIL import Image

    chroma = None
    for sampling in _LAYOUTS:
        file = io.BytesIO()
        Image.fromarray(image).save(file, "JPEG", quality=95, subsampling=sampling)
        check_blocks(file.getvalue())
        chroma = jpeg_chroma(file.getvalue())
    return chroma


def _read(data: bytes) -> _File | None:
    # Imported here, since lossless images do not need it.
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
        # A step of 0 is damage.
        if not np.all(tables):
            return None
    except (OSError, SyntaxError, LookupError, Image.DecompressionBombError):
        # Damage, or a size beyond Pillow's limit, that OpenCV decodes all the same.
        return None
    if not layout.exact:
        # Means of 8 bits would be rounded up.
        planes = means(planes.astype(np.float32), layout.scale)
    steps = [np.array(table, np.float64).reshape(_BLOCK, _BLOCK) for table in tables]
    return _File(layout, read_only(planes), (height, width), steps)


def _light_variance(file: _File) -> float:
    """Variance of a pixel of Y by quantisation, in squared 8-bit code values."""
    scale = file.layout.scale
    size = _BLOCK // scale
    steps = (file.steps[0][:size, :size] / scale).astype(np.float32)
    found = _transform(_blocks(file.planes[..., 0], size, size)[::STRIDE])
    found = np.rint(found / steps) * steps
    return _rounding_variance(*_beyond(-found, steps), steps, bounded=False)


def _blocks(plane: NDArray[Any], rows: int, columns: int) -> Blocks:
    """Blocks of an image, whose border pixels are repeated to fill the last ones."""
    height, width = plane.shape
    tall, wide = -(-height // rows), -(-width // columns)
    padded = np.pad(
        plane, ((0, tall * rows - height), (0, wide * columns - width)), mode="edge")
    return padded.reshape(tall, rows, wide, columns).swapaxes(1, 2).astype(np.float32)


def _transform(blocks: Blocks) -> Blocks:
    """Cosine transform (DCT-II) of each block, orthonormal."""
    return np.asarray(dctn(blocks, axes=(2, 3), norm="ortho"))


def _restore(
    light: Blocks, colour: Blocks, steps: NDArray[np.float32], exact: bool
) -> tuple[Blocks, float, float]:
    """Restore a chroma plane by its prediction from luma, within the file's intervals.

    `light` and `colour` are coefficients of luma and chroma, `steps` (rows, columns) those of the
    quantisation; with `exact` the coefficients are the file's, but for rounding of pixels.

    Returns pixels in blocks, the variance of a pixel's remaining error, and the mean slope of
    chroma over luma, weighted by texture.
    """
    weight = 1.0 / (steps**2 / 12.0 + UNRELATED_VARIANCE)
    # A block's mean has no slope of its own: that over its neighbours' means is used.
    along, against = (
        weight[0, 0] * each for each in _neighbours(light[..., 0, 0], colour[..., 0, 0]))
    weight[0, 0] = 0.0
    if exact:
        # Undo the decoder's rounding of pixels: the file has multiples of the steps.
        colour = np.rint(colour / steps) * steps
    square = against + np.einsum("vu,ijvu->ij", weight, light**2)
    slopes = np.zeros(light.shape[:2], np.float32)
    reach = 0.5 * steps
    for k in range(ROUNDS):
        # First the middle of the interval, then the prediction clipped to it.
        within = colour
        if k > 0:
            within = colour + np.clip(
                slopes[..., np.newaxis, np.newaxis] * light - colour, -reach, reach)
        product = along + np.einsum("vu,ijvu,ijvu->ij", weight, light, within, optimize=True)
        # Prior of the slope: mean 0, variance 1; it decides in blocks without texture.
        slopes = (product / (square + 1.0)).astype(np.float32)
    away = slopes[..., np.newaxis, np.newaxis] * light - colour
    variance = _rounding_variance(*_beyond(away[::STRIDE], steps), steps, bounded=True)
    reach[0, 0] = 0.0
    pixels = idctn(colour + np.clip(away, -reach, reach), axes=(2, 3), norm="ortho")
    return np.asarray(pixels), variance, float((slopes * square).sum() / (square.sum() + 1e-9))


def _neighbours(
    light: NDArray[np.float32], colour: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Covariance of luma and chroma means over 3x3 blocks, and variance of luma means, (h, w) each.

    Computed in `float64` minus the overall mean, since squares of means lose digits.
    """
    y, value = (np.asarray(each - each.mean(), np.float64) for each in (light, colour))
    number, sum_y, sum_value, product, square = (
        cv2.boxFilter(each, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        for each in (np.ones_like(y), y, value, y * value, y * y))
    return (
        ((product - sum_y * sum_value / number) / number).astype(np.float32),
        np.maximum((square - sum_y**2 / number) / number, 0.0).astype(np.float32))


def _beyond(away: Blocks, steps: NDArray[np.float32]) -> tuple[Array, Array]:
    """Share of coefficients predicted outside of their intervals, and their mean distance from it.

    `away` is the prediction minus the middle of the interval.
    """
    over = np.maximum(np.abs(away) - 0.5 * steps, 0.0)
    missed = (over > 0).sum(axis=(0, 1))
    return (
        missed / (over.shape[0] * over.shape[1]),
        over.sum(axis=(0, 1), dtype=np.float64) / np.maximum(missed, 1))


def _rounding_variance(
    missed: Array, beyond: Array, steps: NDArray[np.float32], bounded: bool
) -> float:
    """Variance of a pixel's error by quantisation, in squared 8-bit code values.

    Differences of true and predicted coefficients are modelled by a Laplace distribution, whose
    scale is inverse to frequency as amplitudes of natural images are (Field 1987,
    doi 10.1364/JOSAA.4.002379). The scale is estimated from `_beyond` by expectation maximisation.
    With `bounded`, a coefficient predicted outside of its interval was set to its nearest end,
    otherwise to its middle.
    """
    detail = np.ones(steps.shape, np.bool_)
    detail[0, 0] = False
    frequency = np.hypot(*np.indices(steps.shape))[detail]
    step, missed, beyond = steps.astype(np.float64)[detail], missed[detail], beyond[detail]
    scale = 4.0
    for _ in range(SCALE_ROUNDS):
        b = np.maximum(scale / frequency, LEAST_SCALE * step)
        inside = np.exp(-0.5 * step / b)
        near = (b - (b + 0.5 * step) * inside) / (1.0 - inside)
        far = beyond + b - step / np.expm1(step / b)
        scale = float((frequency * ((1.0 - missed) * near + missed * far)).mean())
    b = np.maximum(scale / frequency, LEAST_SCALE * step)
    inside = np.exp(-0.5 * step / b)
    near = (2 * b**2 - (0.25 * step**2 + b * step + 2 * b**2) * inside) / (1 - inside)
    far = step**2 / 12.0
    if bounded:
        whole = np.exp(-step / b)
        far = 2 * b**2 - (step**2 + 2 * b * step) * whole / (1 - whole)
    variance = float(steps[0, 0])**2 / 12.0 + ((1.0 - missed) * near + missed * far).sum()
    return float(variance / steps.size)
