# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Cameras of the random views: transfer curve, vignetting, noise, mosaic and codec."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.transfer import decode, encode
from uw_visibility_lab.simulation.camera import compress, interpolate_mosaic, lens_falloff
from uw_visibility_lab.worlds.beliefs import draw

# Entries of the encoding tables: 8 per code of 16 bit are too many for a cache, 1 per code of
# 8 bit is too few for the steep part of sRGB.
_STEPS = 1 << 16


@dataclass(frozen=True)
class Curve:
    """Transfer from irradiance to code, both 0..1, and continued beyond 1."""

    kind: str  # ``linear``, ``srgb``, ``gamma``, ``log`` or ``contrast``
    value: float = 0.0  # exponent of a gamma, a of log(1 + a x), strength of an S curve

    @property
    def name(self) -> str:
        """Its kind, with its value where it has one."""
        return f"{self.kind} {self.value:.2f}" if self.value else self.kind

    def encode(self, light: NDArray[Any]) -> NDArray[Any]:
        """Code of irradiance, 0 or more."""
        if self.kind in ("linear", "srgb"):
            return encode(light, self.kind)
        if self.kind == "gamma":
            return np.asarray(np.maximum(light, 0.0) ** (1.0 / self.value))
        if self.kind == "log":
            return np.asarray(np.log1p(self.value * light) / np.log1p(self.value))
        # An S curve on sRGB, as in consumer cameras.
        code = encode(light, "srgb")
        inside = np.clip(code, 0.0, 1.0)
        return np.asarray(code + self.value * (inside * inside * (3.0 - 2.0 * inside) - inside))


LINEAR = Curve("linear")
SRGB = Curve("srgb")


def told_linear(curve: Curve, told: str, light: Array) -> Array:
    """Irradiance, (3,), encoded by the curve and linearised by the declared transfer `told`."""
    return decode(curve.encode(np.asarray(light, np.float64)), told)


def draw_curve(rng: np.random.Generator, effects: tuple[str, ...]) -> tuple[Curve, str]:
    """Draw the camera's true curve, and the transfer that is declared to the estimator."""
    told = "srgb" if "srgb" in effects else "linear"
    if "foreign curve" not in effects:
        return (SRGB if told == "srgb" else LINEAR), told
    kind = int(draw(rng, "camera.foreign_curve"))
    if kind == 0:
        return Curve("gamma", draw(rng, "camera.gamma")), told
    if kind == 1:
        return Curve("log", draw(rng, "camera.log_curve")), told
    if kind == 2:
        return SRGB, "linear"
    if kind == 3:
        return LINEAR, "srgb"
    return Curve("contrast", draw(rng, "camera.contrast_curve")), "srgb"


def record(
    streams: Callable[[str], np.random.Generator], irradiance: Map, gains: Array, curve: Curve,
    effects: tuple[str, ...],
) -> NDArray[Any]:
    """Convert irradiance to code values, (H, W, 3): vignetting, noise, mosaic, curve, codec.

    streams: random generator by purpose.
    irradiance: (H, W, 3), with exposure and white balance, 1 is full scale; overwritten.
    gains: (3,), of white balance, for the noise; only their ratios matter.
    curve, effects: of the camera, and active ones of ``draw.EFFECTS``.
    """
    if "vignetting" in effects:
        loss = draw(streams("vignetting"), "camera.vignetting")
        irradiance *= lens_falloff(irradiance.shape[:2], loss)
    if "noise" in effects:
        rng = streams("noise")
        noise = draw(rng, "camera.noise") / 255.0
        read = noise * draw(rng, "camera.noise_read_share")
        # Variance of shot noise is proportional to light; at 0.5 the total deviation is `noise`.
        shot = (noise * noise - read * read) / 0.5
        # White balance multiplies the noise of the sensor.
        gain = (gains / gains[1]).astype(np.float32)
        bits = np.frombuffer(rng.bytes(2 * irradiance.size), np.uint16).reshape(irradiance.shape)
        _add_noise(
            irradiance, bits, _normal_quantiles(), np.float32(shot) * gain,
            np.float32(read * read) * gain * gain)
    if "bayer" in effects:
        irradiance = interpolate_mosaic(irradiance * np.float32(255.0)) / np.float32(255.0)
    deep = "16 bit" in effects and "jpeg" not in effects
    table = _table(curve, deep)
    image: NDArray[Any] = np.empty(irradiance.shape, table.dtype)
    _encode(irradiance, table, image)
    if "jpeg" in effects:
        image = compress(image, round(draw(streams("jpeg"), "camera.jpeg")))
    return image


@njit(nogil=True, error_model="numpy")
def _add_noise(light: Any, bits: Any, quantiles: Any, shot: Any, read: Any) -> None:
    """Add normal noise of variance shot · light + read, by channel, to (H, W, 3) in place."""
    for row in range(light.shape[0]):
        for column in range(light.shape[1]):
            for c in range(3):
                value = light[row, column, c]
                variance = shot[c] * max(value, np.float32(0.0)) + read[c]
                light[row, column, c] = value + math.sqrt(variance) * quantiles[
                    bits[row, column, c]]


@njit(nogil=True, error_model="numpy")
def _encode(light: Any, table: Any, image: Any) -> None:
    """Look up the codes of light, (H, W, 3), clipped to 0..1."""
    steps = np.float32(len(table) - 1)
    for row in range(light.shape[0]):
        for column in range(light.shape[1]):
            for c in range(3):
                # This order turns NaN into black; as an index it would be undefined.
                value = min(max(np.float32(0.0), light[row, column, c]), np.float32(1.0))
                image[row, column, c] = table[int(value * steps + np.float32(0.5))]


@lru_cache(maxsize=1)
def _normal_quantiles() -> NDArray[np.float32]:
    """2^16 quantiles of the normal distribution, to be indexed by 16 random bits."""
    return ndtri((np.arange(1 << 16) + 0.5) / (1 << 16)).astype(np.float32)


@lru_cache(maxsize=8)
def _table(curve: Curve, deep: bool) -> NDArray[Any]:
    top = 65535 if deep else 255
    code = curve.encode(np.linspace(0.0, 1.0, _STEPS)) * top + 0.5
    return np.clip(code, 0, top).astype(np.uint16 if deep else np.uint8)
