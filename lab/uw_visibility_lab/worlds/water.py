# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Random sea water: with spectra between those of Jerlov's types, or as in the paper."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.optics.water_type import (
    BACKSCATTERED,
    TYPES,
    WAVELENGTHS,
    clear_water,
    daylight_response,
    inherent_properties,
)
from uw_visibility_lab.worlds.beliefs import draw, happens

RESPONSES = ("nikon_d5100", "generic", "sigma_sdmerrill")
"""In the order of the belief ``camera.response``."""

PATHS = np.concatenate([[0.0], np.geomspace(0.05, 200.0, 48)])
"""Ranges at which band averages are tabulated, m; in between, their logarithms are nearly
linear."""

# Wavelengths at which absorption by dissolved matter and scattering by particles are given, nm.
CDOM_WAVELENGTH, PARTICLE_WAVELENGTH = 440.0, 550.0


@dataclass(frozen=True)
class Water:
    """Water in the camera's channels, (3,) RGB; light of 1 is white at the surface."""

    depth: float  # of the camera, m
    clear_water: Array  # declared κ, 1/m
    attenuation: Array  # β of surfaces' light, 1/m
    diffuse: Array  # K, diffuse attenuation of daylight, 1/m
    light: Array  # W at that depth
    ratio: Array  # B/W
    forward: Array  # scattering by a few degrees, 1/m: beam attenuation is β + this
    # (n, 3) each; logarithms of the band-averaged transmission over `PATHS`, and of
    # 1 − veil / veil at infinity; None where each channel has one β
    tables: tuple[Array, Array] | None = None


@cache
def _ladder() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Logarithms of a and b of Jerlov's types, (types, wavelengths) each, 1/m."""
    pairs = [inherent_properties(name, WAVELENGTHS) for name in TYPES]
    least = clear_water(WAVELENGTHS)
    absorption = np.stack([np.maximum(pair[0], least[0]) for pair in pairs])
    scattering = np.stack([np.maximum(pair[1], 0.5 * least[1]) for pair in pairs])
    return np.log(absorption), np.log(scattering)


@cache
def _camera(name: str) -> tuple[Array, Array, Array]:
    """Response, and response times daylight, (n, 3) each, with a sum of 1 per channel; κ, 1/m."""
    response = load_response(name)
    plain, lit = response.at(WAVELENGTHS), daylight_response(response)
    return plain / plain.sum(0), lit / lit.sum(0), clear_water_attenuation(response)


def draw_water(
    rng: np.random.Generator, *, spectrum: bool = False, red_gone: bool = False
) -> Water:
    """Draw water, its light and the camera's response.

    spectrum: integrate E = ∫ s L (ρ e^(−βd) + ω (1 − e^(−βd))) dλ, so that β falls with range.
    red_gone: the camera is so deep that no red light is left.
    """
    name = RESPONSES[int(draw(rng, "camera.response"))]
    told = name
    if happens(rng, "camera.wrong_response"):
        told = RESPONSES[int(draw(rng, "camera.response"))]
    spread = np.array([draw(rng, "camera.clear_water_spread") for _ in range(3)])
    clear = _camera(told)[2] * spread
    depth = draw(rng, "water.depth_red_gone" if red_gone else "water.depth")
    if happens(rng, "water.paper") and not spectrum:
        return _paper_water(rng, name, clear, depth)
    absorption, scattering = _draw_spectra(rng)
    _, lit, _ = _camera(name)
    kept = draw(rng, "water.forward_share")
    diffuse = draw(rng, "water.downward_path") * (absorption + BACKSCATTERED * scattering)
    depth = min(depth, draw(rng, "water.darkest") / float(diffuse.min()))
    lost = scattering * (1.0 - kept)
    beam = absorption + lost
    weights = lit * np.exp(-diffuse * depth)[:, np.newaxis]
    light = weights.sum(0)
    # Relative weights: they are defined even for a channel with hardly any light.
    share = weights / light
    albedo = (share * (lost / beam)[:, np.newaxis]).sum(0)
    ratio = _draw_ratio(rng, albedo)
    weight, tables = _camera(name)[0], None
    if spectrum:
        weight, decay = share, np.exp(-np.outer(PATHS, beam))
        veil = share * (lost / beam)[:, np.newaxis] / albedo
        with np.errstate(divide="ignore"):
            tables = (
                np.maximum(np.log(decay @ share), -200.0), np.maximum(np.log(decay @ veil), -200.0))
    return Water(
        depth, clear, beam @ weight, diffuse @ weight, light, ratio, (kept * scattering) @ weight,
        tables)


def _paper_water(rng: np.random.Generator, name: str, clear: Array, depth: float) -> Water:
    """Clear water and particles with one attenuation per channel, and fading light (the paper)."""
    particles = np.full(3, draw(rng, "water.paper_attenuation"))
    if happens(rng, "water.clear"):
        particles *= 0.0
    if not happens(rng, "water.paper_grey"):
        weight = np.array([draw(rng, "water.channel_spread") for _ in range(3)])
        particles = particles * weight / weight.mean()
    pure = _camera(name)[2]
    diffuse = pure + draw(rng, "water.paper_diffuse") * particles
    attenuation = pure + particles
    depth = min(depth, draw(rng, "water.darkest") / float(diffuse.min()))
    return Water(
        depth, clear, attenuation, diffuse, np.exp(-diffuse * depth),
        _draw_ratio(rng, np.ones(3), "veil.as_light_paper"),
        draw(rng, "water.paper_halo") * particles)


def _draw_spectra(rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw absorption and scattering at `WAVELENGTHS`, 1/m."""
    absorptions, scatterings = _ladder()
    pure = clear_water(WAVELENGTHS)
    if happens(rng, "water.clear"):
        return pure[0], 0.5 * pure[1]
    place = draw(rng, "water.jerlov")
    lower = min(int(place), len(TYPES) - 2)
    part = place - lower
    absorption, scattering = (
        np.exp((1.0 - part) * table[lower] + part * table[lower + 1])
        for table in (absorptions, scatterings))
    excess = np.maximum(absorption - pure[0], 0.0) * draw(rng, "water.absorption_spread")
    if happens(rng, "water.cdom_more"):
        slope = draw(rng, "water.cdom_slope")
        excess = excess + draw(rng, "water.cdom") * np.exp(
            -slope * (WAVELENGTHS - CDOM_WAVELENGTH))
    slope = draw(rng, "water.particle_slope")
    scattering = scattering * draw(rng, "water.scattering_spread") * (
        PARTICLE_WAVELENGTH / WAVELENGTHS) ** slope
    return pure[0] + excess, scattering


def _draw_ratio(
    rng: np.random.Generator, albedo: Array, as_light: str = "veil.as_light"
) -> Array:
    """Draw B/W, (3,): single scattering gives the veil the colour of ω = b/(a + b)."""
    if happens(rng, as_light):
        return np.ones(3)
    spread = np.array([draw(rng, "veil.ratio_spread") for _ in range(3)])
    return np.asarray(draw(rng, "veil.ratio") * spread * albedo / albedo.max())
