# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Traced scenes as folders: written by `uw_visibility render`, read without a tracer."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from uw_visibility.config.files import write_whole
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility_lab.tracer.scene import Description
from uw_visibility_lab.tracer.truth import (
    Decay,
    fit_decay,
    scene_light,
    transmissions,
    veil_at_infinity,
)

TRUTH = "truth.json"
"""Written last: a folder that has it is complete."""

EXPOSURE = (0.99, 0.9)
"""Quantile of the image's brightest channel, and the code value that it gets, 1 is full."""

FULL = 65535


@dataclass(frozen=True)
class Traced:
    """A traced view with its truth. Light is in units of the image; (3,) is RGB."""

    kind: str  # of the scene
    seed: int  # that it was drawn with
    image: Array  # (H, W, 3) float32; RGB, linear, 0 .. 1, without a sensor's noise
    ranges: Array  # (H, W) float32; m along the line of sight, NaN in open water
    # attenuation, attenuation_stddev: (3,), 1/m; of surfaces' light, image less black, over the
    # surfaces' radiance. Light of the floor that water scatters into the view is in it, so it is
    # nearer to absorption than to c
    attenuation: Array
    attenuation_stddev: Array
    # attenuation_contrast, attenuation_contrast_stddev: (3,), 1/m; of the difference of bright and
    # dark patches at the same range; nearer to c. `truth.transmissions` has both
    attenuation_contrast: Array
    attenuation_contrast_stddev: Array
    # (3,), 1/m; rate at which the veil of black surfaces saturates with range; NaN where ranges are
    # too short for that
    veil_growth: Array
    beam_attenuation: Array  # beam_attenuation, absorption, scattering: (3,), 1/m
    absorption: Array
    scattering: Array
    veil: Array  # (3,); B; NaN where the view does not show it
    light: Array  # (3,); W: radiance of a white surface, median over the scene
    surface: Array  # (H, W, 3) float32; radiance of the surfaces without water before them
    black: Array  # (H, W, 3) float32; the veil alone: surfaces are black
    reflectance: Array  # (H, W, 3) float32; of the surfaces
    focal_length: float  # px
    baseline: float  # m
    truth: dict[str, Any]  # all that truth.json holds


def _listed(values: Array) -> list[float | None]:
    """Return numbers as JSON has them: null for NaN."""
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in np.asarray(values, float)]


def _decay(decay: Decay) -> dict[str, list[float | None]]:
    return {name: _listed(values) for name, values in asdict(decay).items()}


def exposure(image: Array) -> float:
    """Return the gain that makes an image of radiances one of code values."""
    share, level = EXPOSURE
    return level / max(float(np.quantile(image.max(axis=-1), share)), 1e-12)


def truth_of(
    description: Description, focal_length: float, gain: float, samples: int,
    arrays: dict[str, Array],
) -> dict[str, Any]:
    """Return what is true of a traced view, as JSON has it.

    focal_length: px.
    gain: image over radiance.
    samples: paths for each pixel and channel of the image.
    Returns in units of the image, 1/m and m.
    """
    ranges = arrays["ranges"]
    # A denoised veil is smooth, but its mean may be off: for a sum the raw one, for a slope this.
    decays = {
        name: fit_decay(*transmissions(
            arrays["raw"], arrays[veil], arrays["surface"], ranges, contrast=contrast))
        for name, veil, contrast in (("all", "raw_black", False), ("contrast", "black", True))}
    veil, source, growth = veil_at_infinity(arrays["image"], arrays["black"], ranges)
    water = description.water
    seen = ranges[np.isfinite(ranges)]
    return {
        "description": asdict(description),
        "focal_length": focal_length,
        "baseline": description.baseline,
        "samples": samples,
        "gain": gain,
        "absorption": list(water.absorption),
        "scattering": list(water.scattering),
        "beam_attenuation": _listed(water.beam_attenuation),
        "single_scattering_albedo": _listed(water.albedo),
        "attenuation": _decay(decays["all"]),
        "attenuation_contrast": _decay(decays["contrast"]),
        "veil": _listed(veil),
        "veil_source": source,
        "veil_growth": _listed(growth),
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
    codes = np.round(image[..., ::-1] * FULL).astype(np.uint16)
    shown = np.where(image <= 0.0031308, 12.92 * image, 1.055 * image ** (1 / 2.4) - 0.055)
    for name, pixels in ((f"{view}.png", codes),
                         (f"{view}_srgb.png", np.round(shown[..., ::-1] * 255).astype(np.uint8))):
        made, data = cv2.imencode(".png", pixels)
        if not made:
            raise InputError(f"{folder / name}: OpenCV cannot write it")
        write_whole(folder / name, data.tobytes())
    kept: dict[str, Any] = {
        name: np.asarray(a, np.float32) for name, a in arrays.items() if name != "image"}
    np.savez_compressed(folder / f"{view}.npz", **kept)


def read_view(folder: Path, view: str = "left") -> dict[str, Array]:
    """Read what `write_view` has written.

    Raises `InputError` if a file is missing or is none of its kind.
    """
    codes = cv2.imread(str(folder / f"{view}.png"), cv2.IMREAD_UNCHANGED)
    if codes is None or codes.dtype != np.uint16 or codes.ndim != 3:
        raise InputError(f"{folder / view}.png is no 16-bit colour image: render the scene again")
    try:
        with np.load(folder / f"{view}.npz", allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder / view}.npz cannot be read: render the scene again") from error
    return {"image": codes[..., ::-1].astype(np.float32) / FULL, **arrays}


def write_truth(folder: Path, truth: dict[str, Any]) -> None:
    """Write truth.json, by which a folder is complete."""
    write_whole(folder / TRUTH, json.dumps(truth, indent=1, ensure_ascii=False) + "\n")


def read_truth(folder: Path) -> dict[str, Any]:
    """Read truth.json; an `InputError` if it is missing or damaged."""
    try:
        truth = json.loads((folder / TRUTH).read_text(encoding="utf-8"))
        return {**truth, "description": dict(truth["description"])}
    except OSError as error:
        raise InputError(
            f"{folder} has no {TRUTH}: give a folder that uw_visibility render has written"
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder / TRUTH} is damaged: render the scene again") from error


def load(folder: str | Path, view: str = "left") -> Traced:
    """Read a traced scene.

    view: left, or right of a stereo pair. The truth is the left view's.
    Returns image, ranges and truth.
    Raises `InputError` if a file is missing or damaged.
    """
    folder = Path(folder)
    truth = read_truth(folder)
    arrays = read_view(folder, view)
    try:
        def numbers(*path: str) -> Array:
            value: Any = truth
            for name in path:
                value = value[name]
            return np.array([np.nan if v is None else v for v in value], float)

        return Traced(
            truth["description"]["kind"], truth["description"]["seed"],
            arrays["image"], arrays["ranges"],
            numbers("attenuation", "attenuation"), numbers("attenuation", "stddev"),
            numbers("attenuation_contrast", "attenuation"),
            numbers("attenuation_contrast", "stddev"), numbers("veil_growth"),
            numbers("beam_attenuation"), numbers("absorption"), numbers("scattering"),
            numbers("veil"), numbers("light"),
            arrays["surface"], arrays["black"], arrays["reflectance"],
            float(truth["focal_length"]), float(truth["baseline"]), truth)
    except (KeyError, TypeError) as error:
        raise InputError(f"{folder / TRUTH} is damaged: render the scene again") from error
