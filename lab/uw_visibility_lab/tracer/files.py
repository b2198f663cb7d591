# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Traced scenes as folders: written by `uw_visibility render`, read without a tracer."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.config.files import write_whole
from uw_visibility.errors import refusing
from uw_visibility.images.arrays import Array
from uw_visibility.images.files import read_image, write_png
from uw_visibility.optics.transfer import from_linear
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.tracer.scene import Description
from uw_visibility_lab.tracer.truth import fit_decay, open_water, scene_light, transmissions

TRUTH = "truth.json"
"""Written last: a folder that has it is complete."""

EXPOSURE = (0.99, 0.9)
"""Quantile of the image's brightest channel, and the code value that it gets, 1 is full."""

FULL = 65535


@dataclass(frozen=True)
class Traced:
    """A traced view with its truth. Light is in units of the image; (3,) is RGB."""

    image: Array  # (H, W, 3) float32; RGB, linear, 0 .. 1, without a sensor's noise
    ranges: Array  # (H, W) float32; m along the line of sight, NaN in open water
    surface: Array  # (H, W, 3) float32; radiance of the surfaces without water before them
    # (3,), 1/m; of surfaces' light, image less black, over the surfaces' radiance. Light of the
    # floor that water scatters into the view is in it, so it is nearer to absorption than to c
    attenuation: Array
    light: Array  # (3,); W: radiance of a white surface, median over the scene
    focal_length: float  # px
    baseline: float  # m
    truth: dict[str, Any]  # all that truth.json holds


def _listed(values: Array) -> list[float | None]:
    """Return numbers as JSON has them: null for NaN."""
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in np.asarray(values, float)]


def exposure(image: Array) -> float:
    """Return the gain that makes an image of radiances one of code values."""
    share, level = EXPOSURE
    return level / max(float(np.quantile(image.max(axis=-1), share)), 1e-12)


def truth_of(
    description: Description, camera: StereoCamera, gain: float, samples: int,
    arrays: dict[str, Array],
) -> dict[str, Any]:
    """Return what is true of a traced view, as JSON has it.

    gain: image over radiance.
    samples: paths for each pixel and channel of the image.
    Returns in units of the image, 1/m and m.
    """
    ranges = arrays["ranges"]
    # A denoised veil is smooth, but its mean may be off: the raw one.
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


def write_view(folder: Path, view: str, arrays: dict[str, Array]) -> None:
    """Write a view: VIEW.png (16 bit, linear), VIEW.npz and VIEW_srgb.png to look at.

    view: left or right.
    arrays: image (H, W, 3), 0 .. 1; ranges (H, W), and further ones.
    """
    image = np.clip(arrays["image"], 0.0, 1.0)
    write_png(folder / f"{view}.png", np.round(image * FULL).astype(np.uint16))
    write_png(folder / f"{view}_srgb.png", from_linear(image, "srgb", np.uint8))
    kept: dict[str, Any] = {
        name: np.asarray(a, np.float32) for name, a in arrays.items() if name != "image"}
    np.savez_compressed(folder / f"{view}.npz", **kept)


def write_truth(folder: Path, truth: dict[str, Any]) -> None:
    """Write truth.json, by which a folder is complete."""
    write_whole(folder / TRUTH, json.dumps(truth, indent=1, ensure_ascii=False) + "\n")


def load(folder: Path) -> Traced:
    """Read the left view of a traced scene.

    Raises `InputError` if a file is missing or damaged.
    """
    whole = f"{folder} holds no whole scene of uw_visibility render: render it again"
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
