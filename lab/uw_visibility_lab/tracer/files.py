# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Traced scenes as folders: written by `uw_visibility render`, read without a tracer.

The true attenuation is the decay of surfaces' light with range: a camera cannot measure more.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from uw_visibility.config.files import write_whole
from uw_visibility.errors import InputError, refusing
from uw_visibility.images.arrays import Array
from uw_visibility.images.files import read_image, write_png
from uw_visibility.optics.transfer import from_linear
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.tracer.scene import Description

TRUTH = "truth.json"
"""Written last: a folder that has it is complete."""

EXPOSURE = (0.99, 0.9)
"""Quantile of the image's brightest channel, and the code value that it gets; 1 is full scale."""

FULL = 65535

BINS = 24
"""Number of bins of range, with equal numbers of pixels."""

FEWEST_PIXELS = 60
"""Least number of pixels in a bin."""

LEAST_OPEN = 0.01
"""Least share of open water from which the veil is measured."""


@dataclass(frozen=True)
class Traced:
    """A traced view with its truth. Light is in units of the image; (3,) is RGB."""

    image: Array  # (H, W, 3) float32; RGB, linear, 0 .. 1, without a sensor's noise
    ranges: Array  # (H, W) float32; m along the line of sight, NaN in open water
    surface: Array  # (H, W, 3) float32; radiance of the surfaces without water in front of them
    # (3,), 1/m; of surfaces' light (image minus black) relative to the surfaces' radiance. It
    # includes scattered light of the floor, so it is closer to absorption than to c
    attenuation: Array
    light: Array  # (3,); W: radiance of a white surface, median over the scene
    focal_length: float  # px
    baseline: float  # m
    truth: dict[str, Any]  # content of truth.json


def _listed(values: Array) -> list[float | None]:
    """Return numbers for JSON: null for NaN."""
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in np.asarray(values, float)]


def exposure(image: Array) -> float:
    """Return the gain from an image's radiances to code values."""
    share, level = EXPOSURE
    return level / max(float(np.quantile(image.max(axis=-1), share)), 1e-12)


def truth_of(
    description: Description, camera: StereoCamera, gain: float, samples: int,
    arrays: dict[str, Array],
) -> dict[str, Any]:
    """Return the ground truth of a traced view, for JSON.

    gain: image over radiance.
    samples: paths for each pixel and channel of the image.
    Returns in units of the image, 1/m and m.
    """
    ranges = arrays["ranges"]
    # From raw images, since denoising may change the mean of the veil.
    attenuation, stddev = fit_decay(*transmissions(
        arrays["raw"], arrays["raw_black"], arrays["surface"], ranges))
    water = description.water
    seen = ranges[np.isfinite(ranges)]
    return {
        "description": asdict(description),
        "focal_length": camera.focal_length,
        "baseline": camera.baseline,
        "samples": samples,
        "gain": gain,
        "absorption": list(water.absorption),
        "scattering": list(water.scattering),
        "beam_attenuation": _listed(water.beam_attenuation),
        "single_scattering_albedo": _listed(water.albedo),
        "attenuation": {"attenuation": _listed(attenuation), "stddev": _listed(stddev)},
        "veil": _listed(open_water(arrays["image"], ranges)),
        "light": _listed(scene_light(arrays["surface"], arrays["reflectance"], ranges)),
        "ranges": _listed(np.quantile(seen, [0.01, 0.5, 0.99])),
        "open_water": round(float(1.0 - np.isfinite(ranges).mean()), 5),
    }


def range_bins(ranges: Array) -> list[NDArray[np.int64]]:
    """Return the flat indices of the pixels of each bin of range, nearest first."""
    flat = np.ravel(ranges)
    seen = np.flatnonzero(np.isfinite(flat))
    ordered = seen[np.argsort(flat[seen], kind="stable")]
    return [part for part in np.array_split(ordered, BINS) if len(part) >= FEWEST_PIXELS]


def transmissions(
    image: Array, veil: Array, surface: Array, ranges: Array,
) -> tuple[Array, Array, Array]:
    """Transmission by range: surfaces' light in the image relative to the surfaces' radiance.

    image: (H, W, 3), light in water, not denoised: denoising flattens texture.
    veil: (H, W, 3), the same with black surfaces.
    surface: (H, W, 3), radiance of the surfaces themselves.
    ranges: (H, W), m, NaN in open water.
    Returns `middles`, (N,), mean range of each bin, m; `values, stddevs`, (N, 3).
    Raises `InputError` if too few pixels have a range.
    """
    parts = range_bins(ranges)
    if len(parts) < 3:
        raise InputError("too few pixels have a range: the view needs more of the scene")
    distance = np.ravel(ranges).astype(float)
    light = (np.asarray(image, float) - veil).reshape(-1, 3)
    given = np.asarray(surface, float).reshape(-1, 3)
    middles = np.array([distance[part].mean() for part in parts])
    values, stddevs = np.empty((2, len(parts), 3))
    for k, part in enumerate(parts):
        seen, source = light[part], given[part]
        # A channel without light has no slope.
        power = np.maximum((source * source).sum(axis=0), 1e-300)
        values[k] = (source * seen).sum(axis=0) / power
        variance = np.square(seen - values[k] * source).sum(axis=0) / (len(part) - 1)
        stddevs[k] = np.sqrt(np.maximum(variance / power, 1e-24))
    return middles, values, stddevs


def fit_decay(middles: Array, values: Array, stddevs: Array) -> tuple[Array, Array]:
    """Fit k e^(-βd) to transmissions, weighted by their noise, with both k and β free.

    k is free since a camera knows neither reflectance nor light.

    middles: (N,), m.
    values, stddevs: (N, 3).
    Returns `attenuation`, β, and `stddev`, (3,), 1/m; NaN if undetermined. The deviation includes
    the samples' noise and the departure from an exponential: it is scaled by √(χ² per degree of
    freedom) if that is above 1.
    """
    attenuation, stddev = np.full((2, 3), np.nan)
    for channel in range(3):
        value, noise = values[:, channel], stddevs[:, channel]
        used = np.isfinite(value) & np.isfinite(noise) & (noise > 0.0)
        # A decay needs 3 bins above their noise.
        if used.sum() >= 3 and (value[used] > 3.0 * noise[used]).sum() >= 3:
            attenuation[channel], stddev[channel] = _fit(middles[used], value[used], noise[used])
    return attenuation, stddev


def _fit(distance: Array, value: Array, noise: Array) -> tuple[float, float]:
    clear = value > 3.0 * noise
    weight = np.where(clear, value / noise, 0.0)
    slope, height = np.polyfit(
        distance, np.log(np.where(clear, value, 1.0)), 1, w=weight)

    # 0.5 % of each value is added to the noise, so that no single bin dominates.
    spread = np.hypot(noise, 0.005 * np.abs(value))

    def residual(unknown: Array) -> Array:
        return np.asarray((np.exp(unknown[0] - unknown[1] * distance) - value) / spread)

    fit = least_squares(residual, [height, -slope])
    scatter = max(1.0, float(fit.fun @ fit.fun) / max(len(value) - 2, 1))
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * scatter
    return float(fit.x[1]), math.sqrt(float(covariance[1, 1]))


def open_water(image: Array, ranges: Array) -> Array:
    """Veil B: the median of open water, (3,); NaN if too little of it is in view.

    image: (H, W, 3). ranges: (H, W), m, NaN in open water.
    """
    opened = ~np.isfinite(ranges)
    if opened.mean() < LEAST_OPEN:
        return np.full(3, np.nan)
    return np.asarray(np.median(image[opened], axis=0))


def scene_light(surface: Array, reflectance: Array, ranges: Array) -> Array:
    """Light W on the scene: median of the surfaces' radiance over their reflectance, (3,)."""
    known = np.isfinite(ranges) & (reflectance.min(axis=-1) > 0.02)
    return np.asarray(np.median(surface[known] / reflectance[known], axis=0), float)


def write_view(folder: Path, arrays: dict[str, Array]) -> None:
    """Write a view: left.png (16 bit, linear), left.npz, and left_srgb.png for display.

    arrays: image (H, W, 3), 0 .. 1; ranges (H, W), and further ones.
    """
    image = np.clip(arrays["image"], 0.0, 1.0)
    write_png(folder / "left.png", np.round(image * FULL).astype(np.uint16))
    write_png(folder / "left_srgb.png", from_linear(image, "srgb", np.uint8))
    kept: dict[str, Any] = {
        name: np.asarray(a, np.float32) for name, a in arrays.items() if name != "image"}
    np.savez_compressed(folder / "left.npz", **kept)


def write_truth(folder: Path, truth: dict[str, Any]) -> None:
    """Write truth.json, which marks a folder as complete."""
    write_whole(folder / TRUTH, json.dumps(truth, indent=1, ensure_ascii=False) + "\n")


def load(folder: Path) -> Traced:
    """Read a traced scene.

    Raises `InputError` if a file is missing or damaged.
    """
    whole = f"{folder} holds no complete scene of uw_visibility render: render it again"
    with refusing(whole, OSError, KeyError, TypeError, ValueError):
        truth = json.loads((folder / TRUTH).read_text(encoding="utf-8"))
        attenuation, light = (
            np.array([np.nan if value is None else value for value in values], float)
            for values in (truth["attenuation"]["attenuation"], truth["light"]))
        codes = read_image(folder / "left.png")
        with np.load(folder / "left.npz", allow_pickle=False) as stored:
            ranges, surface = stored["ranges"], stored["surface"]
        return Traced(
            codes.astype(np.float32) / FULL, ranges, surface, attenuation, light,
            float(truth["focal_length"]), float(truth["baseline"]), truth)
