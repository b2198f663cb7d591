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
from uw_visibility.water.observations import Envelopes, quantile_of_known
from uw_visibility.water.veil_gradient import VeilGradient, fit_gradient

# The search looks at so many cells along the image's width, of 4 px at least.
CELLS = 100
CELL_LEAST = 4
# Largest part of a cell's pixels that may have a range.
MATCHED = 0.15
# Variance of smooth water over that of noise and rounding, and in 8-bit codes beside it.
ROUGHNESS = 3.0
ROUGHNESS_LEAST = 0.35
# Photons' noise, which the image's darkest parts do not show: variance per 8-bit code.
PHOTONS = 0.015
# Neighbouring cells differ by less than this part, or so many 8-bit codes.
GRADIENT = 0.05
GRADIENT_LEAST = 1.0
# Cells around an area that are compared with it, and the part of them that may go on alike
# (of a small and of a large area, by their parts of the image: in turbid water the far scene
# itself is as bright as the veil).
REACH = 2
REACH_AREAS = (0.01, 0.05)
CONTINUED = (0.5, 0.85)
# Part of the image that open water covers at least.
LEAST_AREA = 0.005
# A scene whose contrast is below this part of that near by has faded into the veil, where
# in between it is no more than so many times more or, in its clearest channel, less than what
# fades evenly, and the light that far is the area's, but for a part.
FADED, FADED_LEAST = 0.15, 0.01
FADED_MORE, FADED_LESS = 1.6, 3.0
FADED_LIGHT = 0.1
# Of a veil that differs by this part before the far scene, contrast is that of all channels
# together, less what the veil adds; a large area, by its part of the image, is asked for less.
UNEVEN = 0.01
SPREAD = 1.5
LARGE_AREA = 0.1
POSSIBLE_AREA = 0.06
LARGE_FADED, LARGE_FADED_LEAST, LARGE_FADED_MORE = 0.25, 0.08, 1.4
# Part of its pixels that may be at the largest code value; cells whose mean is above this
# part of it are none of it.
SATURATED = 0.02
BRIGHTEST_CELL = 0.99
# How much brighter than all matched patches it may be: beyond, it is the surface.
BRIGHTEST = 1.6
# How much redder than the far scene it may be: water takes red first.
REDDER = 0.04
# A close, dark thing is darker than the far scene's dark patches by this part, although
# these grow lighter with range.
DARKER = 0.85
# Far cells are those with ranges beyond this quantile; water counts as it is near to them,
# within this part of the image's width.
FAR = 0.7
NEAR_TO_FAR = 0.15
# What the veil differs between directions, beside what the area itself shows; and what a
# small area differs that may be a smooth, far thing: as much at this part of the image.
DEVIATION = 0.04
SMALL_DEVIATION = 0.3
SMALL_AREA = 0.006


@dataclass(frozen=True)
class OpenWater:
    """Irradiance of open water.

    Attributes
    ----------
    veil, stddev : (3,) float64 ndarray
        Irradiance, and how well it stands for the veil before the scene.
    fraction : float
        Part of the image.
    gradient : VeilGradient
        How the veil changes over the image.
    certain : bool
        Whether outlines or the scene's fading say so; else it may as well be a smooth wall.
    """

    veil: NDArray[np.float64]
    stddev: NDArray[np.float64]
    fraction: float
    gradient: VeilGradient
    certain: bool = True


class _MatchedLight(NamedTuple):
    """Irradiance of the matched scene, (3,) float64 each: bright patches and dark ones.

    `contrast` is their difference near, in the middle and far, (3, 3): ranges by channels;
    `middle` is how far from the near range to the far one the middle is, as a part.
    """

    brightest: NDArray[np.float64]
    bright_far: NDArray[np.float64]
    dark_near: NDArray[np.float64]
    dark_far: NDArray[np.float64]
    contrast: NDArray[np.float64]
    middle: float

    def as_far(self, veil: NDArray[np.float64]) -> bool:
        """Tell whether the far scene is as bright as a veil before it, (3, N)."""
        mean = veil.mean(axis=1)
        same = np.abs(self.bright_far + self.dark_far - 2.0 * mean) < 2.0 * FADED_LIGHT * mean
        return bool(same.all())

    def fades_into(self, veil: NDArray[np.float64], area: float) -> bool:
        """Tell whether the scene fades with range until it is the veil.

        A smooth wall has no contrast either, but what is before it has, and as much as near.

        Parameters
        ----------
        veil : (3, N) float64 ndarray
            Before the far scene, over the image, as an area of open water shows it.
        area : float
            Part of the image that the area takes.
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
        self, seen: NDArray[np.float64], added: float, most: float, least: float, more: float
    ) -> bool:
        """Tell whether contrast, (3, C), less what is added falls evenly to a part of it."""
        seen = np.maximum(seen, 1e-9)
        near, middle, far = np.maximum(seen - added, 1e-9)
        rest = far / near
        fast = seen[1] / seen[0] / np.maximum(rest, FADED_LEAST)**self.middle
        slow = middle / near / np.maximum(rest, least)**self.middle
        return bool(
            fast.max() > 1.0 / FADED_LESS and (rest < most).all() and (slow < more).all())


def find_open_water(
    image: NDArray[Any], range_map: NDArray[np.float32], valid: NDArray[np.bool_] | None,
    irradiance: NDArray[np.float32], envelope: Envelopes,
) -> OpenWater | None:
    """Find open water beyond what is matched.

    Parameters
    ----------
    image : (H, W, 3) uint8 or uint16 ndarray
        Code values.
    range_map : (H, W) float32 ndarray
        m; NaN where unknown.
    valid : (H, W) bool ndarray or None
        Pixels that show the scene.
    irradiance : float32 ndarray
        Of each code value.
    envelope : Envelopes
        What the matched pixels show.

    Returns
    -------
    OpenWater or None
        None where nothing looks like it.
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
    scene = _matched_light(envelope)
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
        if not _is_water(means[part], light, irradiance, scene):
            continue
        share = float(part.mean())
        if _continued(part, means, matched, smooth, code) < allowed:
            area |= part
            continue
        veil = _veil_before(before, part, light)
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
    return OpenWater(veil, stddev, fraction, gradient, certain)


def _places(cells: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Rows and columns of cells, in parts of the image, (N, 2)."""
    return (np.argwhere(cells) + 0.5) / cells.shape


def _veil_before(
    before: NDArray[np.float64], part: NDArray[np.bool_], light: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Veil at places (N, 2), as an area of open water shows it and its gradient, (3, N)."""
    gradient = fit_gradient(light, _places(part), np.full(len(light), 1.0 / len(light)))
    return np.median(light, axis=0)[:, np.newaxis] * gradient.at(before)


def _areas(blank: NDArray[np.bool_]) -> tuple[int, NDArray[np.int32]]:
    """Connected areas, without what is thinner than three cells; their number and labels."""
    opened = cv2.morphologyEx(blank.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    number, labels, about, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
    small = about[:, cv2.CC_STAT_AREA] < max(LEAST_AREA * blank.size, 6)
    order = np.zeros(number, np.int32)
    order[1:][~small[1:]] = np.arange(1, 1 + np.count_nonzero(~small[1:]))
    return int(order.max()) + 1, order[labels]


@njit(nogil=True)
def _share_beyond(range_map: Any, side: int, least: float, share: Any) -> None:
    """Write the part of each cell's pixels whose range is known, and the least one or more."""
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
    """Count in each column; apart from the rest, which makes vector code."""
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
    part: NDArray[np.bool_], means: NDArray[np.float64], matched: NDArray[np.float32],
    smooth: NDArray[np.bool_], code: float,
) -> float:
    """Part of the matched surroundings that goes on as smooth and in the same colour.

    A wall that is unmatched in part is such an area; open water ends at the outlines of
    things.
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


def _matched_light(envelope: Envelopes) -> _MatchedLight:
    """Envelopes at the near and at the far end, medians over bins."""
    bins = len(envelope.range)
    quarter = max(bins // 4, 1)
    near, far = slice(0, quarter), slice(bins - quarter, bins)
    middle = slice(quarter, bins - quarter)
    at_near, at_middle, at_far = (
        np.median(envelope.range[part]) for part in (near, middle, far))
    difference = envelope.bright - envelope.dark
    return _MatchedLight(
        quantile_of_known(envelope.bright, 1.0), quantile_of_known(envelope.bright[:, far], 0.5),
        quantile_of_known(envelope.dark[:, near], 0.5),
        quantile_of_known(envelope.dark[:, far], 0.5),
        np.stack([quantile_of_known(difference[:, part], 0.5) for part in (near, middle, far)]),
        float((at_middle - at_near) / max(at_far - at_near, 1e-9)),
    )


def _light(codes: NDArray[np.float64], irradiance: NDArray[np.float32]) -> NDArray[np.float64]:
    """Irradiance of mean code values, (N, 3)."""
    return irradiance[np.minimum(codes + 0.5, irradiance.size - 1).astype(np.int64)].astype(
        np.float64)


def _is_water(
    codes: NDArray[np.float64], light: NDArray[np.float64], irradiance: NDArray[np.float32],
    scene: _MatchedLight,
) -> bool:
    """Tell open water from close dark objects, the surface, and overexposed areas."""
    if (codes >= 0.995 * (irradiance.size - 1)).any(axis=1).mean() > SATURATED:
        return False
    veil = np.median(light, axis=0)
    if (veil > BRIGHTEST * scene.brightest).all():
        return False
    far_share = scene.bright_far[0] / scene.bright_far.sum()
    if veil[0] / veil.sum() > far_share + REDDER:
        return False
    darker = (veil < DARKER * scene.dark_far) & (scene.dark_far > scene.dark_near)
    return not bool(darker.sum() >= 2)


@njit(nogil=True)
def _smooth(image: Any, side: int, asked: Any, limit: Any, smooth: Any) -> None:
    """Mark cells asked for whose mean squared second difference of codes is below its limit."""
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
