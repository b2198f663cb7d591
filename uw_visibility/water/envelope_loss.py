# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Asymmetric robust loss of the lower envelope (Geman-McClure below, Cauchy above).

A bin holds a patch of radiance ρ ≥ 0 as its darkest, mostly near black. Below the
curve of black there is nothing but noise, rounding, wrong ranges; above it,
whatever the scene is short of. So bins below the curve count by their noise,
bins above it little, and less and less the farther they are.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.optics.light_model import transmission, veil_of

# The scales of the loss, as `set_scales` fills them in.
BELOW, ABOVE, LIMIT_BELOW, LIMIT_ABOVE, NOISE, EXPECTED = range(6)
SCALES = 6

# Part of the direct light by which a patch may look darker than black.
DARKNESS_BELOW = 0.01
# Part by which the darkest patches of bins differ.
DARKNESS_ABOVE = 0.2
# Bins above the curve lose weight beyond this part of their scale, bins below it
# beyond so many times their scale: they can only be wrong. Measured ranges often are: a few
# wrong matches among a bin's own, and it would count as much as all bins above the curve. That
# is for a veil that is the light, whose level the brightest patch tells.
OUTLIER_ABOVE = 0.25
OUTLIER_BELOW = 5.0
OUTLIER_BELOW_MEASURED = 2.0
# How far from black the darkest patches of a scene are all together, on average
# and at one standard deviation, in parts of how far bins differ.
EXPECTED_DARKNESS = 0.2
DARKNESS_DEVIATION = 0.2
DARKNESS_DEVIATION_MIN = 0.015
# ... and so much more where the light on the scene is brighter than the veil, up to this.
BRIGHTEST_LIGHT = 4.0
# ... and in parts of what the brightest patch is short of a bright one.
BRIGHT_RADIANCE = 0.8
DULLNESS_DEVIATION = 0.3
# Where the veil is free, that is the most. How bright the light is, and so how dull the scene, is
# one of the things that are averaged over then, and where bins differ little, and are black with
# a veil as bright as the light, some of their patches are: less of what they differ by is open,
# and the more the more they differ.
FREE_DARKNESS_MIN = 0.012
FREE_DARKNESS = 0.05
FREE_DARKNESS_GROWTH = 0.4
FREE_BRIGHT_RADIANCE = 0.75
FREE_DULLNESS = 0.2
# Bins show darkness where direct light is so many times the noise.
INFORMATIVE = 5.0
UNKNOWN_DARKNESS = 0.3


@njit(nogil=True)
def transmit(p: Any, distance: Any, left: Any) -> None:
    """Write the transmission of each bin, (3, N), for parameters `p`.

    Apart from what takes it, since exponentials are most of a fit's time.
    """
    for c in range(3):
        for i in range(distance.shape[1]):
            left[c, i] = transmission(p[2 * c], distance[c, i])


@njit(nogil=True)
def set_scales(
    p: Any, distance: Any, left: Any, dark: Any, deviation: Any, known: Any, range_error: float,
    darkness: float, light: Any, outlier: float, scale: Any,
) -> None:
    """Set the scales of residuals for parameters `p`.

    Parameters
    ----------
    p : (6,) float64 ndarray
        β_R, I∞_R, β_G, I∞_G, β_B, I∞_B.
    distance, dark, deviation : (3, N) float64 ndarray
        Range, irradiance and its standard deviation of the darkest patches.
    left : (3, N) float64 ndarray
        Transmission; see `transmit`.
    known : (3, N) bool ndarray
        Bins that count.
    range_error : float
        Standard deviation of range over its square, 1/m.
    darkness : float
        How far from black the darkest patches are expected to be, in parts of how
        far bins differ.
    light : (3,) float64 ndarray
        Light on the scene over the veil, W / B.
    outlier : float
        Scales below the curve beyond which a bin loses weight.
    scale : (SCALES, 3, N) float64 ndarray
        Filled.
    """
    for c in range(3):
        for i in range(distance.shape[1]):
            d = distance[c, i]
            veil = p[2 * c + 1] * left[c, i]
            direct = light[c] * veil
            displacement = range_error * d * d * p[2 * c] * veil
            variance = deviation[c, i] ** 2 + displacement * displacement
            scale[NOISE, c, i] = np.sqrt(variance)
            scale[BELOW, c, i] = np.sqrt(variance + (DARKNESS_BELOW * direct) ** 2)
            scale[ABOVE, c, i] = np.sqrt(variance + (DARKNESS_ABOVE * direct) ** 2)
            scale[LIMIT_ABOVE, c, i] = OUTLIER_ABOVE * scale[ABOVE, c, i]
            scale[LIMIT_BELOW, c, i] = outlier * scale[BELOW, c, i]
    typical = typical_darkness(p, left, dark, known, light, scale)
    for c in range(3):
        shown = np.isfinite(typical[c])
        scale[EXPECTED, c, :] = darkness * light[c] * typical[c] if shown else 0.0


@njit(nogil=True)
def typical_darkness(
    p: Any, left: Any, dark: Any, known: Any, light: Any, scale: Any
) -> Any:
    """Median radiance of the darkest patches of bins, in each channel; NaN where none shows."""
    result = np.empty(3)
    radiance = np.empty(dark.shape[1])
    for c in range(3):
        number = 0
        for i in range(dark.shape[1]):
            veil = p[2 * c + 1] * left[c, i]
            direct = light[c] * veil
            if known[c, i] and direct > INFORMATIVE * scale[NOISE, c, i]:
                excess = dark[c, i] - p[2 * c + 1] + veil
                radiance[number] = min(max(excess / direct, 0.0), 1.0)
                number += 1
        result[c] = np.median(radiance[:number]) if number > 0 else np.nan
    return result


@njit(nogil=True)
def residual(p: Any, left: Any, dark: Any, scale: Any, c: int, i: int) -> float:
    """Residual of a bin: its irradiance above the curve of the darkest patches."""
    return float(dark[c, i] - veil_of(p[2 * c + 1], left[c, i] * (1.0 - scale[EXPECTED, c, i])))


@njit(nogil=True)
def loss(r: float, scale: Any, c: int, i: int) -> tuple[float, float]:
    """Geman-McClure (below the curve) or Cauchy (above) cost of a residual, and its weight."""
    if r < 0:
        sigma, limit = scale[BELOW, c, i], scale[LIMIT_BELOW, c, i]
        q = 1.0 + (r / limit) ** 2
        return (r / sigma) ** 2 / q, 1.0 / (q * sigma) ** 2
    sigma, limit = scale[ABOVE, c, i], scale[LIMIT_ABOVE, c, i]
    q = 1.0 + (r / limit) ** 2
    return (limit / sigma) ** 2 * np.log(q), 1.0 / (q * sigma * sigma)


@njit(nogil=True)
def deviance(
    p: Any, left: Any, dark: Any, known: Any, scale: Any
) -> tuple[float, float]:
    """Minus twice the logarithm of the bins' likelihood, and the residuals' part a bin.

    As if bins were independent. The loss alone is no likelihood: it leaves bins far off at
    no cost. Here they follow Cauchy's law above the curve, and Student's of three degrees
    below it.
    """
    residuals, widths, bins = 0.0, 0.0, 0
    for c in range(3):
        for i in range(dark.shape[1]):
            if not known[c, i]:
                continue
            above = np.hypot(scale[NOISE, c, i], OUTLIER_ABOVE * scale[ABOVE, c, i])
            below = scale[BELOW, c, i]
            r = residual(p, left, dark, scale, c, i)
            if r < 0:
                residuals += 4.0 * np.log1p((r / below) ** 2 / 3.0)
            else:
                residuals += 2.0 * np.log1p((r / above) ** 2)
            # Areas below Cauchy's half, and Student's.
            widths += 2.0 * np.log(0.5 * np.pi * above + 1.36 * below)
            bins += 1
    return residuals + widths, residuals / max(bins, 1)


@njit(nogil=True)
def durbin_watson(p: Any, left: Any, dark: Any, known: Any, scale: Any) -> float:
    """Durbin-Watson statistic of the bins' residuals over range, the median channel's.

    Squared differences of neighbours over squares: 2 where residuals know nothing of their
    neighbours, and less the smoother their course over range is (Durbin and Watson 1950,
    doi:10.1093/biomet/37.3-4.409). Residuals are compressed (inverse hyperbolic sine), and
    taken from their median.
    """
    statistics = np.full(3, np.nan)
    course = np.empty(dark.shape[1])
    for c in range(3):
        bins = 0
        for i in range(dark.shape[1]):
            if known[c, i]:
                course[bins] = np.arcsinh(
                    residual(p, left, dark, scale, c, i) / scale[BELOW, c, i])
                bins += 1
        if bins == 0:
            continue
        away = course[:bins] - np.median(course[:bins])
        squares = (away**2).sum()
        statistics[c] = (np.diff(away) ** 2).sum() / squares if squares > 0.0 else 2.0
    return float(np.nanmedian(statistics))


@njit(nogil=True)
def total_loss(p: Any, left: Any, dark: Any, known: Any, scale: Any) -> float:
    """Cost of all bins."""
    cost = 0.0
    for c in range(3):
        for i in range(dark.shape[1]):
            if known[c, i]:
                cost += loss(residual(p, left, dark, scale, c, i), scale, c, i)[0]
    return cost


@njit(nogil=True)
def add_normal_equations(
    p: Any, distance: Any, left: Any, dark: Any, known: Any, scale: Any, hessian: Any, slope: Any
) -> float:
    """Add the bins' curvature and descent direction; return their cost."""
    cost = 0.0
    derivative = np.empty(2)
    for c in range(3):
        for i in range(dark.shape[1]):
            if not known[c, i]:
                continue
            r = residual(p, left, dark, scale, c, i)
            part, weight = loss(r, scale, c, i)
            cost += part
            differentiate(p, distance, left, scale, c, i, derivative)
            for j in range(2):
                slope[2 * c + j] += weight * derivative[j] * r
                for k in range(2):
                    hessian[2 * c + j, 2 * c + k] += weight * derivative[j] * derivative[k]
    return cost


@njit(nogil=True)
def differentiate(
    p: Any, distance: Any, left: Any, scale: Any, c: int, i: int, derivative: Any
) -> None:
    """Derivatives of the curve by attenuation and ambient light."""
    fading = left[c, i] * (1.0 - scale[EXPECTED, c, i])
    derivative[0] = p[2 * c + 1] * distance[c, i] * fading
    derivative[1] = 1.0 - fading


@njit(nogil=True)
def darkness_deviation(typical: float, brightest: float, light: float, one_light: bool) -> float:
    """Standard deviation of how far from black a scene's darkest patches are.

    A dull scene is one without black as well as without white.
    """
    shown = typical if np.isfinite(typical) else UNKNOWN_DARKNESS
    # A veil that is dimmer than the light leaves more of what is not black to be seen, and
    # says less of what is.
    over = min(max(light, 1.0), BRIGHTEST_LIGHT)
    dullness = min(max(BRIGHT_RADIANCE - brightest, 0.0), 1.0)
    most = (
        DARKNESS_DEVIATION_MIN * over + DARKNESS_DEVIATION * shown + DULLNESS_DEVIATION * dullness)
    if one_light:
        return most
    dullness = min(max(FREE_BRIGHT_RADIANCE - brightest, 0.0), 1.0)
    part = FREE_DARKNESS * over**2 + FREE_DARKNESS_GROWTH * (shown + dullness)
    return min(most, FREE_DARKNESS_MIN * over**2 + part * shown + FREE_DULLNESS * over * dullness)
