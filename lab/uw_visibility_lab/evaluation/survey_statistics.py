# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Statistical colour correction of a survey, as a peer of the enhancement under lamps.

After M. Bryson, M. Johnson-Roberson, O. Pizarro and S. B. Williams, True color correction of
autonomous underwater vehicle imagery, J. Field Robotics 33 (2016), doi 10.1002/rob.21638, and
the public description of attenuation correction in processors of whole dives; written from
these, not from anyone's code. No lamp is known. At every position in the image and in every
channel, intensity against range over all frames is fitted with I(d) = a e^(−bd) + c; a
pixel is brought to the reference range by the ratio of the fit there and at its own range. Then
each position's mean and standard deviation over the frames are made the same everywhere and in
all channels (the ground is taken for grey on average). How large the one is against the other
is left to the user there; here the darkest pixels of the survey come to black, without
which what water scatters would stay as a haze.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Map

BLOCK = 16
"""Width of a position in px: the light of lamps is as smooth, and more ground passes it."""

SMOOTHING = 1.5
"""Standard deviation in positions of the smoothing of their means: over 100 frames a single
one has seen too little ground. Without, the same ground varies by a sixth more."""

RATES = np.geomspace(0.05, 2.5, 40)
"""Rates b that are tried, 1/m: faster than light falls under lamps."""

DARKEST = 0.005
"""Share of a frame's pixels that come to black, on average over the frames."""

FEWEST = 5
"""Frames that a fit of three numbers needs at the least."""


@dataclass(frozen=True)
class SurveyStatistics:
    """Intensity over range at every position, and what is left after correcting for it."""

    curve: Array  # (3, h, w, 3); a, b and c by block and channel
    mean: Array  # mean, deviation: (h, w, 3); over the frames, once at the reference range
    deviation: Array
    reference: float  # reference range, m
    target_mean: float  # target_mean, target_deviation: what mean and standard deviation become
    target_deviation: float

    @classmethod
    def fit(cls, images: Sequence[Map], ranges: Sequence[Map]) -> SurveyStatistics:
        """Fit a survey's images (irradiance 0 .. 1) and ranges (m; not finite = unknown)."""
        if len(images) < FEWEST:
            raise InputError(
                f"a survey of {len(images)} frames: the statistical method needs {FEWEST} or more")
        means = np.array([
            _smooth(_cut(image).mean(axis=(1, 3), dtype=np.float64)) for image in images])
        distances = np.array([_block_ranges(distance) for distance in ranges])
        if not np.isfinite(distances).any():
            raise InputError("no frame of the survey has ranges")
        curve = _fit_curves(means, distances)
        reference = float(np.nanmedian(distances))
        at_reference = np.array([
            _to_reference(image, distance, curve, reference)
            for image, distance in zip(images, ranges, strict=True)
        ])
        mean = _over_frames(at_reference)
        square = _over_frames(np.square(at_reference))
        deviation = np.sqrt(np.maximum(square - np.square(mean), 1e-12))
        level = float(mean.mean())
        scores = [_scores(image, mean, deviation) for image in at_reference]
        darkest = float(np.mean([np.nanquantile(score, DARKEST) for score in scores]))
        return cls(curve, mean, deviation, reference, level, level / max(-darkest, 1.0))

    def correct(self, image: Map, ranges: Map) -> Map:
        """Correct a frame; not below 0, NaN where the range is unknown."""
        corrected = _to_reference(image, ranges, self.curve, self.reference)
        score = _scores(corrected, self.mean, self.deviation)
        return np.maximum(self.target_mean + self.target_deviation * score, np.float32(0.0))


def _scores(image: Map, mean: Array, deviation: Array) -> Map:
    """Standard score of each pixel at its position."""
    return (image - _pixels(mean, image.shape)) / _pixels(deviation, image.shape)


def _to_reference(image: Map, ranges: Map, curve: Array, reference: float) -> Map:
    """Multiply each pixel by the fit at the reference range over that at its own."""
    a, b, c = (_pixels(part, image.shape) for part in curve)
    distance = np.where(np.isfinite(ranges), ranges, np.nan)[..., np.newaxis]
    gain = (a * np.exp(-b * reference) + c) / np.maximum(a * np.exp(-b * distance) + c, 1e-9)
    return np.asarray(image * gain, dtype=np.float32)


def _fit_curves(means: Array, distances: Array) -> Array:
    """Least squares of a e^(−bd) + c with a and c ≥ 0, for each b of a grid; the best counts.

    Takes (n, h, w, 3) intensities and (n, h, w) ranges; returns (3, h, w, 3).
    """
    known = np.isfinite(distances)[..., np.newaxis] & np.isfinite(means)
    weight = known.astype(np.float64)
    light = np.where(known, means, 0.0)
    distance = np.where(np.isfinite(distances), distances, 0.0)[..., np.newaxis]
    count = np.maximum(weight.sum(axis=0), 1.0)
    best = np.full(means.shape[1:], np.inf)
    curve = np.zeros((3, *means.shape[1:]))
    for rate in RATES:
        decay = weight * np.exp(-rate * distance)
        sum_e, sum_ee = decay.sum(axis=0), np.square(decay).sum(axis=0)
        sum_i, sum_ei = light.sum(axis=0), (decay * light).sum(axis=0)
        determinant = np.maximum(sum_ee * count - sum_e**2, 1e-12)
        a = (sum_ei * count - sum_e * sum_i) / determinant
        c = (sum_i - a * sum_e) / count
        # On a bound one number is left.
        a = np.where(c < 0.0, sum_ei / np.maximum(sum_ee, 1e-12), np.maximum(a, 0.0))
        c = np.where(c < 0.0, 0.0, np.where(a == 0.0, sum_i / count, c))
        cost = np.square(weight * (light - c) - a * decay).sum(axis=0)
        better = cost < best
        best = np.where(better, cost, best)
        for k, value in enumerate((a, np.full_like(a, rate), c)):
            curve[k] = np.where(better, value, curve[k])
    return curve


def _over_frames(images: NDArray[np.floating]) -> Array:
    """Mean over the frames' known pixels in each block, (h, w, 3)."""
    known = np.isfinite(images)
    total, count = (
        sum(_cut(image).sum(axis=(1, 3), dtype=np.float64) for image in some)
        for some in (np.where(known, images, 0.0), known)
    )
    return _smooth(total / np.maximum(count, 1.0))


def _smooth(blocks: Array) -> Array:
    return np.asarray(cv2.GaussianBlur(blocks, (0, 0), SMOOTHING))


def _block_ranges(ranges: Map) -> Array:
    """Median range of each block, (h, w); NaN where less than half of it is known."""
    cut = _cut(np.where(np.isfinite(ranges), ranges, np.nan)[..., np.newaxis])[..., 0]
    known = np.isfinite(cut).mean(axis=(1, 3)) >= 0.5
    filled = np.where(known[:, np.newaxis, :, np.newaxis], cut, 0.0)
    return np.where(known, np.nanmedian(filled, axis=(1, 3)), np.nan)


def _cut(image: NDArray[np.floating]) -> NDArray[np.floating]:
    """Cut an image into blocks, (h, block, w, block, channels); the edges' repeat pixels."""
    rows, columns = (-(-n // BLOCK) * BLOCK for n in image.shape[:2])
    padded = np.pad(
        image, ((0, rows - image.shape[0]), (0, columns - image.shape[1]), (0, 0)), mode="edge")
    return padded.reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK, image.shape[2])


def _pixels(blocks: Array, shape: tuple[int, ...]) -> Map:
    """Interpolate what is known by blocks to pixels, (H, W, 3)."""
    rows, columns = (n * BLOCK for n in blocks.shape[:2])
    # Near pixels keep their block's value up to the middle of the outermost block.
    large = cv2.resize(
        blocks.astype(np.float32), (columns, rows), interpolation=cv2.INTER_LINEAR)
    return np.asarray(large[: shape[0], : shape[1]])
