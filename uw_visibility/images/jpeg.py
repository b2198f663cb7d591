# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""JPEG chroma at its stored resolution, restored within its quantisation intervals, with its noise.

The file holds each coefficient of a block's cosine transform (ITU-T T.81) rounded to
a multiple of its step: the true one lies within half of a step. Steps of colour are
coarse, so that most of its detail is rounded to none, while brightness keeps its own.
Decoded as it stands, a dark speck is dark by as much in all channels, also in one
that water has left little of, and red comes out below black. But light and shade move
colour along with brightness: the part that a block's coarse coefficients show tells
of its fine ones. So each is taken where brightness predicts it, within the file's interval.
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

from uw_visibility.compute.jit import njit
from uw_visibility.config.files import read_regular
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

    Of half of the image's resolution in 16 bit, or of all of it in 8 bit. None where the file holds
    no colour, or holds it in a form that is not known: its pixels have to do.
    """
    file = _read(data)
    if file is None:
        return None
    scale, rows, columns, exact = file.layout
    # Means of pixels are finer than their codes.
    code = 257 if scale > 1 else 1
    colour = np.empty((*file.shape, 3), np.uint16)
    # Steps of the transform over these blocks instead of over 8x8 pixels.
    size = math.sqrt(rows * columns) / _BLOCK
    steps = np.stack([size * table[:rows, :columns] for table in file.steps[1:]])
    steps = steps.astype(np.float32)
    missed, beyond = np.empty((2, 2, rows, columns))
    slope = np.empty(2)
    restore_colour(
        file.planes, exact, steps, _cosines(columns), _cosines(rows), colour, np.float32(code),
        missed, beyond, slope,
    )
    variances = [rounding_variance(missed[c], beyond[c], steps[c], True) for c in range(2)]
    noise = _noise(_light_variance(file), variances, slope)
    if scale == 1:
        colour = colour.astype(np.uint8)
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
    count_rounded(file.planes, steps, _cosines(size), missed, beyond)
    return rounding_variance(missed, beyond, steps, False)


def _noise(light: float, colour: list[float], slope: Array) -> Array:
    """Standard deviation of R, G, B, of which colour follows the errors of light."""
    of_cb = np.array([0.0, -GREEN_OF_CB, BLUE_OF_CB], np.float64)
    of_cr = np.array([RED_OF_CR, -GREEN_OF_CR, 0.0], np.float64)
    follows = 1.0 + of_cb * slope[0] + of_cr * slope[1]
    return np.asarray(np.sqrt(follows**2 * light + of_cb**2 * colour[0] + of_cr**2 * colour[1]))


@lru_cache(maxsize=4)
def _cosines(size: int) -> NDArray[np.float32]:
    """Cosine transform (DCT-II) as a matrix, orthonormal."""
    at = np.arange(size)
    matrix = np.cos(np.pi * (2 * at + 1) * at[:, np.newaxis] / (2 * size)) * math.sqrt(2 / size)
    matrix[0] /= math.sqrt(2)
    return np.ascontiguousarray(matrix, np.float32)


# Variance of a coefficient of colour that brightness does not tell.
UNRELATED_VARIANCE = np.float32(0.5)
# Rounds of prediction within the intervals, and of the slope that fits it.
ROUNDS = 3
# Rounds that find how far true coefficients are from predicted ones.
SCALE_ROUNDS = 30
# Rows of blocks of which one is counted: they are many.
STRIDE = 4
# Deviations below this part of a step are as good as none.
LEAST_SCALE = 1.0 / 300.0
NEUTRAL = np.float32(128.0)
# YCbCr to RGB: ITU-T T.871.
RED_OF_CR, BLUE_OF_CB = np.float32(1.402), np.float32(1.772)
GREEN_OF_CB, GREEN_OF_CR = np.float32(0.344136), np.float32(0.714136)


@njit(nogil=True, error_model="numpy")
def restore_colour(
    planes: Any, rounded: bool, steps: Any, across: Any, down: Any, colour: Any, code: Any,
    missed: Any, beyond: Any, slope: Any,
) -> None:
    """Decode colour within the file's intervals, as brightness predicts it.

    planes: (h, w, 3) uint8, Y, Cb and Cr; `rounded` says that they hold the file's coefficients
        unchanged.
    steps: (2, rows, columns) float32, steps of the coefficients of Cb and Cr, by vertical and
        horizontal frequency.
    across, down: (columns, columns), (rows, rows) float32, cosine transform of a row and of a
        column of a block, orthonormal.
    colour: (H, W, 3) uint16, filled with R, G, B, `code` for one of the planes' codes; not larger
        than the planes.
    missed, beyond: (2, rows, columns) float64, filled: share of the coefficients that are not
        predicted within their interval, and how far they are from it on average.
    slope: (2,) float64, filled: change of Cb and Cr with Y, on average where there is texture.
    """
    rows, columns = down.shape[0], across.shape[0]
    tall, wide = -(-planes.shape[0] // rows), -(-planes.shape[1] // columns)
    weight = np.float32(1.0) / (steps * steps / np.float32(12.0) + UNRELATED_VARIANCE)
    # The mean is no detail; how it goes along with brightness, its neighbours tell.
    weight_of_mean = weight[:, 0, 0].copy()
    weight[:, 0, 0] = 0
    mean = _block_means(planes, tall, wide, rows, columns)
    # All blocks of a row lie side by side, so that loops over them vectorise.
    block = np.empty((3, rows, columns, wide), np.float32)
    coefficient = np.empty((3, rows, columns, wide), np.float32)
    scratch = np.empty((rows, columns, wide), np.float32)
    slopes, strength, along, against, product = np.empty((5, wide), np.float32)
    missed[:] = 0.0
    beyond[:] = 0.0
    slope[:] = 0.0
    texture = np.full(2, 1e-9)
    for i in range(tall):
        _load(planes, i * rows, block)
        for c in range(3):
            _transform(block[c], down, across, scratch, coefficient[c])
        for c in range(2):
            for j in range(wide):
                along[j], against[j] = _neighbours(mean, i, j, 1 + c)
                along[j] *= weight_of_mean[c]
                against[j] *= weight_of_mean[c]
            if rounded:
                _round(coefficient[1 + c], steps[c])
            _fit(
                coefficient[0], coefficient[1 + c], steps[c], weight[c], along, against, product,
                strength, slopes,
            )
            if i % STRIDE == 0:
                _count(coefficient[0], coefficient[1 + c], steps[c], slopes, missed[c], beyond[c])
            _predict(coefficient[0], coefficient[1 + c], steps[c], slopes)
            for j in range(wide):
                slope[c] += slopes[j] * strength[j]
                texture[c] += strength[j]
            _transform(coefficient[1 + c], down.T, across.T, scratch, block[1 + c])
        _store(block, i * rows, code, colour)
    slope /= texture
    _share(missed, beyond, tall, wide)


@njit(nogil=True, error_model="numpy")
def _block_means(planes: Any, tall: int, wide: int, rows: int, columns: int) -> Any:
    """(tall, wide, 3): coefficient of each block's mean."""
    height, width = planes.shape[:2]
    mean = np.zeros((tall, wide, 3), np.float32)
    gain = np.float32(np.sqrt(rows * columns))
    for i in range(tall):
        bottom = min((i + 1) * rows, height)
        for j in range(wide):
            right = min((j + 1) * columns, width)
            light = cb = cr = 0
            for y in range(i * rows, bottom):
                for x in range(j * columns, right):
                    light += planes[y, x, 0]
                    cb += planes[y, x, 1]
                    cr += planes[y, x, 2]
            share = gain / np.float32((bottom - i * rows) * (right - j * columns))
            mean[i, j, 0] = np.float32(light) * share
            mean[i, j, 1] = np.float32(cb) * share
            mean[i, j, 2] = np.float32(cr) * share
    return mean


@njit(nogil=True, error_model="numpy")
def _load(planes: Any, top: int, block: Any) -> None:
    """Take a row of blocks; beyond the image its last pixels go on."""
    height, width = planes.shape[:2]
    _, rows, columns, wide = block.shape
    for y in range(rows):
        row = planes[min(top + y, height - 1)]
        for x in range(columns):
            for j in range(wide):
                at = min(j * columns + x, width - 1)
                block[0, y, x, j] = np.float32(row[at, 0])
                block[1, y, x, j] = np.float32(row[at, 1]) - NEUTRAL
                block[2, y, x, j] = np.float32(row[at, 2]) - NEUTRAL


@njit(nogil=True, error_model="numpy")
def _transform(block: Any, down: Any, across: Any, scratch: Any, result: Any) -> None:
    """Transform blocks that lie side by side: down · block · acrossᵀ."""
    rows, columns, wide = block.shape
    # Rows of blocks as one: the longer a loop, the less it costs.
    lines, halves = block.reshape(rows, columns * wide), scratch.reshape(rows, columns * wide)
    for v in range(rows):
        target = halves[v]
        target[:] = 0
        for y in range(0, rows, 4):
            a, b, c, d = down[v, y], down[v, y + 1], down[v, y + 2], down[v, y + 3]
            first, second, third, fourth = lines[y], lines[y + 1], lines[y + 2], lines[y + 3]
            for k in range(columns * wide):
                target[k] += a * first[k] + b * second[k] + c * third[k] + d * fourth[k]
    for v in range(rows):
        for u in range(columns):
            target = result[v, u]
            target[:] = 0
            for x in range(0, columns, 4):
                a, b, c, d = across[u, x], across[u, x + 1], across[u, x + 2], across[u, x + 3]
                first, second = scratch[v, x], scratch[v, x + 1]
                third, fourth = scratch[v, x + 2], scratch[v, x + 3]
                for j in range(wide):
                    target[j] += a * first[j] + b * second[j] + c * third[j] + d * fourth[j]


@njit(nogil=True, error_model="numpy")
def _neighbours(mean: Any, i: int, j: int, c: int) -> tuple[Any, Any]:
    """Covariance of a plane's block means with those of Y around a block, and Y's variance."""
    number = np.float32(0)
    light = colour = product = square = np.float32(0)
    for k in range(max(i - 1, 0), min(i + 2, mean.shape[0])):
        for n in range(max(j - 1, 0), min(j + 2, mean.shape[1])):
            # From the block itself, since squares of means lose digits.
            y, value = mean[k, n, 0] - mean[i, j, 0], mean[k, n, c] - mean[i, j, c]
            number += np.float32(1)
            light += y
            colour += value
            product += y * value
            square += y * y
    return (product - light * colour / number) / number, (square - light * light / number) / number


@njit(nogil=True, error_model="numpy")
def _round(colour: Any, steps: Any) -> None:
    """Take off what decoding to whole numbers has added to coefficients."""
    rows, columns, wide = colour.shape
    for v in range(rows):
        for u in range(columns):
            step, values = steps[v, u], colour[v, u]
            for j in range(wide):
                values[j] = np.rint(values[j] / step) * step


@njit(nogil=True, error_model="numpy")
def _fit(
    light: Any, colour: Any, steps: Any, weight: Any, along: Any, against: Any, product: Any,
    square: Any, slopes: Any,
) -> None:
    """Fit the slope of colour over light in each block, within the intervals of colour."""
    rows, columns, wide = colour.shape
    square[:] = against
    for v in range(rows):
        for u in range(columns):
            of_light, w = light[v, u], weight[v, u]
            for j in range(wide):
                square[j] += w * of_light[j] * of_light[j]
    slopes[:] = 0
    for k in range(ROUNDS):
        product[:] = along
        for v in range(rows):
            for u in range(columns):
                # At first the middle of the interval, then what is predicted within it.
                reach = np.float32(0.5) * steps[v, u] if k > 0 else np.float32(0)
                of_light, of_colour, w = light[v, u], colour[v, u], weight[v, u]
                for j in range(wide):
                    away = slopes[j] * of_light[j] - of_colour[j]
                    within = of_colour[j] + min(max(away, -reach), reach)
                    product[j] += w * of_light[j] * within
        for j in range(wide):
            # A slope is of the order of 1: that is all that a block without texture tells.
            slopes[j] = product[j] / (square[j] + np.float32(1))


@njit(nogil=True, error_model="numpy")
def _count(
    light: Any, colour: Any, steps: Any, slopes: Any, missed: Any, beyond: Any
) -> None:
    """Add how many coefficients are predicted beyond their intervals, and how far."""
    rows, columns, wide = colour.shape
    for v in range(rows):
        for u in range(columns):
            reach = np.float32(0.5) * steps[v, u]
            of_light, of_colour = light[v, u], colour[v, u]
            for j in range(wide):
                over = abs(slopes[j] * of_light[j] - of_colour[j]) - reach
                missed[v, u] += over > 0
                beyond[v, u] += max(over, np.float32(0))


@njit(nogil=True, error_model="numpy")
def _predict(light: Any, colour: Any, steps: Any, slopes: Any) -> None:
    """Move coefficients of colour to where those of light predict them within their intervals."""
    rows, columns, wide = colour.shape
    for v in range(rows):
        for u in range(columns):
            # The mean is no detail.
            reach = np.float32(0.5) * steps[v, u] if v + u > 0 else np.float32(0)
            of_light, of_colour = light[v, u], colour[v, u]
            for j in range(wide):
                away = slopes[j] * of_light[j] - of_colour[j]
                of_colour[j] += min(max(away, -reach), reach)


@njit(nogil=True, error_model="numpy")
def _store(block: Any, top: int, code: Any, colour: Any) -> None:
    """Write a row of blocks as R, G, B."""
    columns, wide = block.shape[2:]
    half = np.float32(0.5)
    largest = code * np.float32(255)
    for y in range(min(block.shape[1], colour.shape[0] - top)):
        for u in range(columns):
            light, cb, cr = block[0, y, u], block[1, y, u], block[2, y, u]
            for j in range(wide):
                red = light[j] + RED_OF_CR * cr[j]
                green = light[j] - GREEN_OF_CB * cb[j] - GREEN_OF_CR * cr[j]
                blue = light[j] + BLUE_OF_CB * cb[j]
                light[j] = min(max(code * red, np.float32(0)), largest) + half
                cb[j] = min(max(code * green, np.float32(0)), largest) + half
                cr[j] = min(max(code * blue, np.float32(0)), largest) + half
            target = colour[top + y, u::columns]
            for j in range(len(target)):
                target[j, 0] = np.uint16(light[j])
                target[j, 1] = np.uint16(cb[j])
                target[j, 2] = np.uint16(cr[j])


@njit(nogil=True, error_model="numpy")
def count_rounded(planes: Any, steps: Any, across: Any, missed: Any, beyond: Any) -> None:
    """As `restore_colour` for brightness, of which nothing is predicted.

    `missed` is the share of the coefficients that are not zero, `beyond` how far those are from
    half of a step on average.
    """
    size = steps.shape[0]
    tall, wide = -(-planes.shape[0] // size), -(-planes.shape[1] // size)
    block = np.empty((3, size, size, wide), np.float32)
    scratch = np.empty((size, size, wide), np.float32)
    result = np.empty((size, size, wide), np.float32)
    none = np.zeros(wide, np.float32)
    missed[:] = 0.0
    beyond[:] = 0.0
    for i in range(0, tall, STRIDE):
        _load(planes, i * size, block)
        _transform(block[0], across, across, scratch, result)
        _round(result, steps)
        _count(result, result, steps, none, missed, beyond)
    _share(missed, beyond, tall, wide)


@njit(nogil=True, error_model="numpy")
def _share(missed: Any, beyond: Any, tall: int, wide: int) -> None:
    """Turn sums into shares and means."""
    beyond /= np.maximum(missed, 1.0)
    missed /= -(-tall // STRIDE) * wide


@njit(nogil=True, error_model="numpy")
def rounding_variance(missed: Any, beyond: Any, steps: Any, bounded: bool) -> float:
    """Variance that is missing from a pixel, in squared 8-bit code values.

    How far true coefficients are from the predicted ones is taken as Laplace's
    distribution, and falls with frequency as natural images do (amplitude as its
    inverse; Field 1987, doi 10.1364/JOSAA.4.002379). Intervals tell its scale, by
    expectation and maximisation. `bounded` says that a coefficient that was predicted beyond its
    interval was set to the near end of it, instead of to its middle.
    """
    rows, columns = steps.shape
    scale = 4.0
    for _ in range(SCALE_ROUNDS):
        total = 0.0
        for v in range(rows):
            for u in range(columns):
                if v + u == 0:
                    continue
                frequency = np.sqrt(float(v * v + u * u))
                step = float(steps[v, u])
                b = max(scale / frequency, LEAST_SCALE * step)
                inside = np.exp(-0.5 * step / b)
                near = (b - (b + 0.5 * step) * inside) / (1.0 - inside)
                far = beyond[v, u] + b - step / np.expm1(step / b)
                total += frequency * ((1.0 - missed[v, u]) * near + missed[v, u] * far)
        scale = total / (rows * columns - 1)
    variance = steps[0, 0] ** 2 / 12.0
    for v in range(rows):
        for u in range(columns):
            if v + u == 0:
                continue
            step = float(steps[v, u])
            b = max(scale / np.sqrt(float(v * v + u * u)), LEAST_SCALE * step)
            inside = np.exp(-0.5 * step / b)
            near = (2 * b * b - (0.25 * step**2 + b * step + 2 * b * b) * inside) / (1 - inside)
            far = step**2 / 12.0
            if bounded:
                whole = np.exp(-step / b)
                far = 2 * b * b - (step**2 + 2 * b * step) * whole / (1 - whole)
            variance += (1.0 - missed[v, u]) * near + missed[v, u] * far
    return float(variance / (rows * columns))
