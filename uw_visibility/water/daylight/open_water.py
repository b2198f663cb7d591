# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Open water in an image: large smooth areas without ranges, whose light is the veil B."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.water.daylight.veil_gradient import VeilGradient, fit_gradient
from uw_visibility.water.observations import Envelopes, quantile_of_known

# Cells along the image's width, and their least side, px.
CELLS = 100
CELL_LEAST = 4
# Largest fraction of an open cell's pixels that have a range.
MATCHED = 0.15
# Variance of smooth water: over that of noise and rounding, plus a deviation in 8-bit codes,
ROUGHNESS = 3.0
ROUGHNESS_LEAST = 0.35
# plus photon noise, which the darkest parts do not show, per 8-bit code.
PHOTONS = 0.015
# Largest difference of neighbouring cells, relative or in 8-bit codes.
GRADIENT = 0.05
GRADIENT_LEAST = 1.0
# Cells around an area that are compared with it, and the fraction of them that may look alike, for
# a small and for a large area: in turbid water the far scene is as bright as the veil.
REACH = 2
REACH_AREAS = (0.01, 0.05)
CONTINUED = (0.5, 0.85)
# Least area of open water, as a fraction of the image.
LEAST_AREA = 0.005
# A scene has faded into the veil if its contrast is below this part of that near by, falls evenly
# in between but for these factors, and its light is the area's but for a part.
FADED, FADED_LEAST = 0.15, 0.01
FADED_MORE, FADED_LESS = 1.6, 3.0
FADED_LIGHT = 0.1
# If the veil in front of the far scene varies by more, all channels are taken together, and what
# the veil adds is subtracted; large areas need to fade less.
UNEVEN = 0.01
SPREAD = 1.5
LARGE_AREA = 0.1
POSSIBLE_AREA = 0.06
LARGE_FADED, LARGE_FADED_LEAST, LARGE_FADED_MORE = 0.25, 0.08, 1.4
# Largest fraction of saturated pixels, and brightest cell over the largest code.
SATURATED = 0.02
BRIGHTEST_CELL = 0.99
# Brighter than all matched patches by more, it is the surface;
BRIGHTEST = 1.6
# redder than the far scene by more, it is no water, which takes red first;
REDDER = 0.04
# darker than the far scene's dark patches, which grow lighter with range, it is a close object.
DARKER = 0.85
# Far cells have ranges beyond this quantile; water near to them counts more, over this part of the
# image's width.
FAR = 0.7
NEAR_TO_FAR = 0.15
# Relative deviation of the veil between directions, and of a small area, which may be a smooth far
# object: at this fraction of the image as likely as not.
DEVIATION = 0.04
SMALL_DEVIATION = 0.3
SMALL_AREA = 0.006


@dataclass(frozen=True)
class OpenWater:
    """Open water in the image.

    Attributes
    ----------
    veil, stddev : (3,) float64 ndarray
        Irradiance, and how well it stands for the veil in front of the scene.
    fraction : float
        Of the image.
    gradient : VeilGradient
    certain : bool
        Whether its outlines or the fading scene prove it; else it may be a smooth wall.
    """

    veil: Array
    stddev: Array
    fraction: float
    gradient: VeilGradient
    certain: bool = True


class _MatchedLight(NamedTuple):
    """Irradiance of the matched scene, (C,): bright and dark patches.

    `contrast` is their difference near, in the middle and far, (3, C); `middle` is where the middle
    lies between the near and the far range, 0..1.
    """

    brightest: Array
    bright_far: Array
    dark_near: Array
    dark_far: Array
    contrast: Array
    middle: float

    def as_far(self, veil: Array) -> bool:
        """Whether the far scene is as bright as the veil in front of it, (C, N)."""
        mean = veil.mean(axis=1)
        same = np.abs(self.bright_far + self.dark_far - 2.0 * mean) < 2.0 * FADED_LIGHT * mean
        return bool(same.all())

    def fades_into(self, veil: Array, area: float) -> bool:
        """Whether the scene fades with range into the veil in front of it, (C, N).

        A smooth wall has no contrast either, but the scene in front of it has as much as near by.
        `area` is the fraction of the image that may be open water.
        """
        if not self.as_far(veil):
            return False
        mean = veil.mean(axis=1)
        differs = float((veil.std(axis=1) / mean).mean())
        if differs < UNEVEN:
            return self._falls_evenly(self.contrast, 0.0, FADED, FADED_LEAST, FADED_MORE)
        together = (self.contrast / mean).mean(axis=1, keepdims=True)
        return area >= LARGE_AREA and self._falls_evenly(
            together, SPREAD * differs, LARGE_FADED, LARGE_FADED_LEAST, LARGE_FADED_MORE)

    def _falls_evenly(
        self, seen: Array, added: float, most: float, least: float, more: float
    ) -> bool:
        """Whether contrast, (3, C), less `added`, falls evenly to a part of it."""
        seen = np.maximum(seen, 1e-9)
        near, middle, far = np.maximum(seen - added, 1e-9)
        rest = far / near
        fast = seen[1] / seen[0] / np.maximum(rest, FADED_LEAST)**self.middle
        slow = middle / near / np.maximum(rest, least)**self.middle
        return bool(fast.max() > 1.0 / FADED_LESS and (rest < most).all() and (slow < more).all())


def find_open_water(
    image: NDArray[Any], range_map: NDArray[np.float32], valid: Mask | None,
    irradiance: NDArray[np.float32], envelope: Envelopes, active: Mask,
) -> OpenWater | None:
    """Find open water beyond the matched scene; None where nothing looks like it.

    Inactive channels get a veil of 1 ± 1. `irradiance` is that of each code value.
    """
    height, width = range_map.shape
    side = max(CELL_LEAST, width // CELLS)
    rows, columns = height // side, width // side
    whole = (slice(rows * side), slice(columns * side))
    size = (columns, rows)
    matched = np.empty((rows, columns), np.float32)
    _share_beyond(range_map, side, np.float32(0), matched)
    if not matched.any():
        return None
    if valid is not None:
        # Cells that do not show the scene are neither matched nor open.
        matched[cv2.resize(
            valid[whole].astype(np.float32), size, interpolation=cv2.INTER_AREA) < 1.0] = np.nan
    void = matched <= MATCHED
    if np.count_nonzero(void) < LEAST_AREA * void.size:
        return None
    means = cv2.resize(image[whole], size, interpolation=cv2.INTER_AREA).astype(np.float64)
    code = irradiance.size / 256
    blank = void.copy()
    _even(means, code, irradiance.size - 1.0, blank)
    number, labels = _areas(blank)
    if number < 2:
        return None
    # Only near to what may be water is it asked how smooth the image is.
    asked = cv2.dilate((labels > 0).astype(np.uint8), np.ones((2 * REACH + 1,) * 2, np.uint8)) > 0
    noise = 1.5 * (envelope.noise**2 + 1.0 / 12.0)
    limit = ROUGHNESS * noise + (ROUGHNESS_LEAST * code) ** 2 + 1.5 * PHOTONS * code * means
    smooth = np.zeros((rows, columns), np.bool_)
    _smooth(image, side, asked, limit, smooth)
    number, labels = _areas(blank & smooth)
    if number < 2:
        return None
    area, possible = np.zeros((2, rows, columns), np.bool_)
    scene = _matched_light(envelope, active)
    samples = range_map[whole][::4, ::4]
    samples = samples[(samples > 0) & (samples < np.inf)]
    beyond = np.empty((rows, columns), np.float32)
    nearest = np.quantile(samples, FAR) if samples.size else 0.0
    _share_beyond(range_map, side, np.float32(nearest), beyond)
    far = beyond > 0.5
    if not far.any():
        return None
    before = _places(far)
    for label in range(1, number):
        part = labels == label
        if np.count_nonzero(part) < max(LEAST_AREA * part.size, 6):
            continue
        allowed = np.interp(np.count_nonzero(part) / part.size, REACH_AREAS, CONTINUED)
        light = _light(means[part], irradiance)
        if not _is_water(means[part], light, irradiance, scene, active):
            continue
        share = float(part.mean())
        if _continued(part, means, matched, smooth, code) < allowed:
            area |= part
            continue
        veil = _veil_before(before, part, light)[active]
        if scene.fades_into(veil, share):
            area |= part
        elif share >= POSSIBLE_AREA and scene.as_far(veil):
            possible |= part
    certain = bool(area.any())
    if not certain:
        area = possible
    if not area.any():
        return None
    light = _light(means[area], irradiance)
    away = cv2.distanceTransform(
        (~far).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)[area] / columns
    weights = np.exp(-(away - away.min()) / NEAR_TO_FAR)
    weights /= weights.sum()
    place = _places(area)
    gradient = fit_gradient(light, place, weights)
    light /= gradient.at(place).T
    veil = weights @ light
    variance = weights @ (light - veil) ** 2 + (veil - light.mean(axis=0)) ** 2
    floor = (0.3 * code * np.diff(irradiance)[np.clip(
        np.searchsorted(irradiance, veil), 0, irradiance.size - 2)])
    fraction = float(np.count_nonzero(area)) / area.size
    unsure = np.hypot(DEVIATION, SMALL_DEVIATION / (1.0 + (fraction / SMALL_AREA) ** 2))
    stddev = np.sqrt(variance + (unsure * veil) ** 2 + floor**2)
    return OpenWater(
        np.where(active, veil, 1.0), np.where(active, stddev, 1.0), fraction, gradient, certain)


def _places(cells: Mask) -> Array:
    """Rows and columns of cells as fractions of the image, (N, 2)."""
    return (np.argwhere(cells) + 0.5) / cells.shape


def _veil_before(before: Array, part: Mask, light: Array) -> Array:
    """Veil at places (N, 2) by the light of an area and its gradient, (3, N)."""
    gradient = fit_gradient(light, _places(part), np.full(len(light), 1.0 / len(light)))
    return np.median(light, axis=0)[:, np.newaxis] * gradient.at(before)


def _areas(blank: Mask) -> tuple[int, NDArray[np.int32]]:
    """Connected areas at least three cells thick: their number and labels."""
    opened = cv2.morphologyEx(blank.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    number, labels, about, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
    small = about[:, cv2.CC_STAT_AREA] < max(LEAST_AREA * blank.size, 6)
    order = np.zeros(number, np.int32)
    order[1:][~small[1:]] = np.arange(1, 1 + np.count_nonzero(~small[1:]))
    return int(order.max()) + 1, order[labels]


@njit(nogil=True)
def _share_beyond(range_map: Any, side: int, least: float, share: Any) -> None:
    """Write the fraction of each cell's pixels that have a range of `least` or more."""
    part = np.float32(1.0 / (side * side))
    columns = np.empty(range_map.shape[1], np.float32)
    for row in range(share.shape[0]):
        columns[:] = 0
        for y in range(row * side, (row + 1) * side):
            _count(range_map[y], least, columns)
        for column in range(share.shape[1]):
            total = np.float32(0)
            for x in range(column * side, (column + 1) * side):
                total += columns[x]
            share[row, column] = total * part


@njit(nogil=True)
def _count(ranges: Any, least: float, columns: Any) -> None:
    """Count in each column; a loop of its own, so that it becomes vector code."""
    nothing, one = np.float32(0), np.float32(1)
    for x in range(columns.size):
        counts = (ranges[x] > nothing) & (ranges[x] < np.float32(np.inf)) & (ranges[x] >= least)
        columns[x] += one if counts else nothing


@njit(nogil=True)
def _even(means: Any, code: float, top: float, even: Any) -> None:
    """Keep cells that are neither black nor saturated, and as bright as their neighbours."""
    rows, columns = even.shape
    for row in range(rows):
        for column in range(columns):
            brightest = 0.0
            for c in range(3):
                here = means[row, column, c]
                brightest = max(brightest, here)
                for below, beside in ((1, 0), (0, 1)):
                    y, x = row + below, column + beside
                    if y < rows and x < columns:
                        there = means[y, x, c]
                        if abs(here - there) > max(GRADIENT * there, GRADIENT_LEAST * code):
                            even[row, column] = False
                            even[y, x] = False
            if brightest <= code or brightest >= BRIGHTEST_CELL * top:
                even[row, column] = False


def _continued(
    part: Mask, means: Array, matched: NDArray[np.float32], smooth: Mask, code: float
) -> float:
    """Fraction of the matched surroundings that continue the area, smooth and of the same colour.

    An unmatched part of a wall continues; open water ends at the outlines of things.
    """
    near = 2 * REACH + 1
    about = tuple(
        slice(max(int(at.min()) - REACH, 0), int(at.max()) + REACH + 1) for at in part.nonzero())
    part, means, matched, smooth = part[about], means[about], matched[about], smooth[about]
    inside = part.astype(np.float64)
    weight = cv2.blur(inside, (near, near), borderType=cv2.BORDER_CONSTANT)
    ring = (weight > 1e-9) & ~part & (matched > 0.5)
    if not ring.any():
        return 0.0
    beside = cv2.blur(means * inside[..., np.newaxis], (near, near), borderType=cv2.BORDER_CONSTANT)
    beside = beside[ring] / weight[ring][:, np.newaxis]
    limit = np.maximum(2.0 * GRADIENT * beside, 2.0 * GRADIENT_LEAST * code)
    same = (np.abs(means[ring] - beside) <= limit).all(axis=1) & smooth[ring]
    return float(same.mean())


def _matched_light(envelope: Envelopes, active: Mask) -> _MatchedLight:
    """Median envelopes of the active channels at the near and the far ranges."""
    bins = len(envelope.range)
    quarter = max(bins // 4, 1)
    near, far = slice(0, quarter), slice(bins - quarter, bins)
    middle = slice(quarter, bins - quarter)
    at_near, at_middle, at_far = (np.median(envelope.range[part]) for part in (near, middle, far))
    dark, bright = envelope.dark[active], envelope.bright[active]
    difference = bright - dark
    return _MatchedLight(
        quantile_of_known(bright, 1.0), quantile_of_known(bright[:, far], 0.5),
        quantile_of_known(dark[:, near], 0.5), quantile_of_known(dark[:, far], 0.5),
        np.stack([quantile_of_known(difference[:, part], 0.5) for part in (near, middle, far)]),
        float((at_middle - at_near) / max(at_far - at_near, 1e-9)))


def _light(codes: Array, irradiance: NDArray[np.float32]) -> Array:
    """Irradiance of mean code values, (N, 3)."""
    return irradiance[np.minimum(codes + 0.5, irradiance.size - 1).astype(np.int64)].astype(
        np.float64)


def _is_water(
    codes: Array, light: Array, irradiance: NDArray[np.float32], scene: _MatchedLight, active: Mask
) -> bool:
    """Tell open water from close dark objects, the surface, and overexposed areas."""
    if (codes >= 0.995 * (irradiance.size - 1)).any(axis=1).mean() > SATURATED:
        return False
    veil = np.median(light, axis=0)[active]
    if (veil > BRIGHTEST * scene.brightest).all() or not veil.any():
        return False
    far_share = scene.bright_far[0] / scene.bright_far.sum()
    if active[0] and veil[0] / veil.sum() > far_share + REDDER:
        return False
    darker = (veil < DARKER * scene.dark_far) & (scene.dark_far > scene.dark_near)
    return not bool(darker.sum() >= min(2, len(veil)))


@njit(nogil=True)
def _smooth(image: Any, side: int, asked: Any, limit: Any, smooth: Any) -> None:
    """Mark cells whose mean squared second difference of codes is below the limit."""
    height, width = image.shape[:2]
    total = np.zeros(3)
    for row in range(asked.shape[0]):
        for column in range(asked.shape[1]):
            if not asked[row, column]:
                continue
            total[:] = 0.0
            count = 0
            for y in range(max(row * side, 2), min((row + 1) * side, height - 2)):
                for x in range(
                    max(column * side, 2) + (y + column) % 2, min((column + 1) * side, width - 2), 2
                ):
                    count += 1
                    for c in range(3):
                        twice = 2.0 * image[y, x, c]
                        across = twice - image[y, x - 2, c] - image[y, x + 2, c]
                        along = twice - image[y - 2, x, c] - image[y + 2, x, c]
                        total[c] += 0.125 * (across * across + along * along)
            below = True
            for c in range(3):
                below &= total[c] <= limit[row, column, c] * max(count, 1)
            smooth[row, column] = below
