# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Flat-field correction of vignetting by lens and housing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import CameraConfig
from uw_visibility.errors import InputError, naming
from uw_visibility.images.arrays import Array, Image
from uw_visibility.images.cells import means
from uw_visibility.images.chroma import ChromaImage
from uw_visibility.images.files import read_image
from uw_visibility.images.pair import read_only
from uw_visibility.optics.transfer import encode_table, linear_table, to_linear

# Least relative illumination for the gain: darker margins show only noise.
LEAST_ILLUMINATION = 0.05
# Share of a flat field's pixels that may be brighter than full illumination, by noise.
_OUTSIDE = 0.001


class FlatFieldCorrection:
    """Flat-field correction of a pair, from flat fields or coefficients of vignetting.

    `centres` are the principal points (x, y) of the left and the right image, px.
    """

    def __init__(
        self,
        config: CameraConfig,
        centres: tuple[tuple[float, float], tuple[float, float]],
        workers: Workers,
    ) -> None:
        self._config = config
        self._centres = centres
        self._workers = workers
        paths = (config.flat_field, config.flat_field_right or config.flat_field)
        self._fields = tuple(_read_field(path, config.transfer) for path in paths)
        self.needed = any(config.vignetting) or any(f is not None for f in self._fields)
        self._gains: list[NDArray[np.float32]] = []

    def correct(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Return the pair as under even illumination; the same arrays without a correction.

        Saturated pixels stay at the largest code value, since their true brightness is unknown.
        Raises `InputError` if a flat field has another size than the images.
        """
        if not self.needed:
            return left, right
        self.allocate((left.shape[0], left.shape[1]))
        first, second = (
            self._apply(image, gain) for image, gain in zip((left, right), self._gains, strict=True)
        )
        return first, second

    def allocate(self, shape: tuple[int, int]) -> None:
        """Prepare the gains for images of a shape (H, W); raises as `correct`."""
        if self.needed and (not self._gains or self._gains[0].shape[:2] != shape):
            self._gains = [self._gain(side, shape) for side in range(2)]

    def correct_chroma(self, chroma: ChromaImage | None) -> ChromaImage | None:
        """Correct the chroma of the left image, with the gains of the last `correct`."""
        if chroma is None or chroma.pixels is None or not self.needed:
            return chroma
        gain = means(self._gains[0], chroma.scale).reshape(
            *chroma.pixels.shape[:2], self._gains[0].shape[2])
        return replace(chroma, pixels=self._apply(chroma.pixels, gain))

    def _gain(self, side: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
        field = self._fields[side]
        if field is None:
            field = illumination(self._config.vignetting, (shape[0], shape[1]), self._centres[side])
            field = field[..., np.newaxis]
        elif field.shape[:2] != shape:
            raise InputError(
                f"the flat field has {field.shape[1]}x{field.shape[0]} px and the image "
                f"{shape[1]}x{shape[0]} px: give a flat field of the (rectified) images' size"
            )
        gain = 1.0 / np.maximum(field, LEAST_ILLUMINATION)
        return np.ascontiguousarray(np.broadcast_to(gain, (*shape, gain.shape[2])), np.float32)

    def _apply(self, image: Image, gain: NDArray[np.float32]) -> Image:
        planes = image[..., np.newaxis] if image.ndim == 2 else image
        if gain.shape[2] not in (1, planes.shape[2]):
            gain = gain.mean(axis=2, keepdims=True)
        corrected = np.empty_like(planes)
        transfer = self._config.transfer
        self._workers.rows(
            _multiply, planes.shape[0], planes, gain, linear_table(transfer, image.dtype),
            encode_table(transfer, image.dtype), corrected,
        )
        return read_only(corrected.reshape(image.shape))


def illumination(
    coefficients: tuple[float, float, float], shape: tuple[int, int], centre: tuple[float, float]
) -> Array:
    """Relative illumination (H, W) by the radial polynomial 1 + a r² + b r⁴ + c r⁶.

    `centre` is column and row of the optical axis, px; r is the distance from it over half of the
    image's diagonal. Usually a is negative.
    """
    height, width = shape
    x = np.arange(width) - centre[0]
    y = np.arange(height)[:, np.newaxis] - centre[1]
    squared = (x**2 + y**2) / (0.25 * (height**2 + width**2))
    a, b, c = coefficients
    return np.asarray(1.0 + squared * (a + squared * (b + squared * c)))


def _read_field(path: str, transfer: str) -> Array | None:
    """Return a flat field as (H, W, C) relative illumination, at most 1; None without a path."""
    if not path:
        return None
    with naming("camera.flat_field"):
        image = read_image(path)
    planes = to_linear(image, transfer).astype(np.float64)
    planes = planes[..., np.newaxis] if image.ndim == 2 else planes
    # Each channel is scaled separately, so that the colour of the field's light does not count.
    full = np.quantile(planes, 1.0 - _OUTSIDE, axis=(0, 1))
    if not (full > 0).all():
        raise InputError(f"camera.flat_field: {path} has a channel without any light")
    return np.asarray(np.minimum(planes / full, 1.0))


@njit(nogil=True)
def _multiply(
    start: int, stop: int, image: Any, gain: Any, decode: Any, encode: Any, corrected: Any
) -> None:
    top = encode.size - 1
    largest = decode.size - 1
    half = np.float32(0.5)
    own = gain.shape[2] > 1
    for y in range(start, stop):
        for x in range(image.shape[1]):
            for c in range(image.shape[2]):
                code = image[y, x, c]
                light = decode[code] * gain[y, x, c if own else 0]
                at = index_of(light * np.float32(top) + half, 0, top)
                corrected[y, x, c] = encode[at] if code < largest else code
