# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Random frames under lamps with ground truth; the lamps are declared with or without errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.lamps import vector
from uw_visibility_lab.simulation.lamp_light import direct_light, gaussian_beam
from uw_visibility_lab.simulation.lamps import Lamp, lighting_parameters, misplaced
from uw_visibility_lab.simulation.phase_functions import (
    FOURNIER_FORAND,
    HENYEY_GREENSTEIN,
    phase_table,
)
from uw_visibility_lab.worlds import lamps as by_lamps
from uw_visibility_lab.worlds.beliefs import draw, happens
from uw_visibility_lab.worlds.camera import LINEAR, record
from uw_visibility_lab.worlds.draw import Streams, scatter_forward, vary
from uw_visibility_lab.worlds.ranging import measure_ranges
from uw_visibility_lab.worlds.scenes import Scene
from uw_visibility_lab.worlds.water import draw_water

EFFECTS = (
    "cosine beam", "rimmed beam", "fournier-forand", "two terms", "facing", "rough", "patches",
    "blur", "beam angle", "misplaced", "unequal", "gaps",
)
"""Departures from correctly declared lamps with Gaussian beams, from the package's phase function,
from Lambertian surfaces and from exact ranges."""

# Effects that exclude one another: the second is left out if the first is active.
_GROUPS = (("facing", "rough"), ("cosine beam", "rimmed beam"), ("fournier-forand", "two terms"))
_RANGING = ("disparity noise", "wrong patches", "occlusion", "unmatched")
# Errors of misplaced lamps: position, m, and direction, degrees.
_SHIFT, _TURN = 0.05, 5.0
_WAVES = 12


@dataclass(frozen=True)
class Night:
    """A frame under lamps, the declared parameters, and the truth."""

    image: NDArray[Any]  # (H, W, 3) uint8; linear RGB code values
    ranges: Map  # (H, W) float32; as measured, m; NaN where unknown
    range_error: float  # declared standard deviation of range over range², 1/m
    focal_length: float  # in widths of the image
    clear_water: Array  # (3,); declared κ, 1/m
    lighting: dict[str, Any]  # declared parameters of the lamps, by name
    attenuation: Array  # (3,); true β, 1/m


def draw_night(
    rng: np.random.Generator, scene: Scene, effects: Sequence[str] | None = None,
    daylight: float | None = None, contrast: float = 1.0,
) -> Night:
    """Draw a frame of a scene under lamps; the same state of `rng` gives the same frame.

    effects: active ones of `EFFECTS`; None draws each with the belief ``lamps.effect``. They do not
        change the rest of the frame.
    daylight: share of daylight in the surfaces' light, averaged over the view, 0 to below 1; both
        lamps and daylight are declared. None: night, and lamps alone are declared.
    contrast: exponent of reflectance relative to its median; 0 for even ground.
    """
    streams = Streams(rng)
    chosen = streams("effects")
    drawn = [name for name in EFFECTS if happens(chosen, "lamps.effect")]
    names = tuple(drawn if effects is None else effects)
    names = tuple(
        name for name in names
        if not any(name in group[1:] and group[0] in names for group in _GROUPS))
    reflectance, ranges, _ = vary(streams("scene"), scene)
    known = np.isfinite(ranges)
    if contrast != 1.0:
        # Open water has a reflectance of 0, which is not that of ground.
        middle = np.maximum(np.median(reflectance[known], axis=0), 1e-3)
        over_middle = np.maximum(reflectance, 1e-3) / middle
        reflectance = (middle * over_middle**contrast).astype(np.float32)
    water = draw_water(streams("water"))
    floating = streams("particles")
    spread = np.array([draw(floating, "water.channel_spread") for _ in range(3)])
    # Attenuation by particles and dissolved matter, 1/m.
    particles = draw(floating, "lamps.particles") * spread / spread.mean()
    beta = water.clear_water + particles
    median = draw(streams("distance"), "lamps.distance")
    # Lamp light covers the range twice.
    median = min(median, 0.5 * draw(streams("path"), "water.most_path") / float(beta.min()))
    ranges *= np.float32(median / float(np.median(ranges[known])))
    focal = scene.focal_length
    if math.isnan(focal):
        focal = draw(streams("focal length"), "camera.focal_length")
    rays = by_lamps.rays_of(ranges.shape, focal)
    rig = _draw_rig(streams("lamps"), names, particles)
    if "patches" in names:
        reflectance = reflectance * _patches(streams("patches"), rays, ranges)
    normals = None if "facing" in names else by_lamps.normals_of(rays, ranges)
    exponent = draw(streams("rough"), "lamps.exponent") if "rough" in names else 1.0
    light = direct_light(rays, ranges, normals, rig.lamps, beta, rig.beam, exponent)
    veil = by_lamps.scattered_light(rays, ranges, rig, beta)
    if daylight:
        left = np.exp(-np.where(known, ranges, np.inf)[..., np.newaxis] * beta)
        level = light[known].mean() / left[known].mean() * daylight / (1.0 - daylight)
        colour = water.light / water.light.max() * level
        light = light + (colour * left).astype(np.float32)
        veil = veil + (colour * water.ratio * (1.0 - left)).astype(np.float32)
    direct = np.asarray(reflectance * light, np.float32)
    if "blur" in names:
        near = np.where(known, ranges, np.float32(1e3))[..., np.newaxis]
        direct = scatter_forward(
            streams("blur"), direct, np.exp(-near * beta.astype(np.float32)))
    irradiance = np.asarray(direct + veil, np.float32)
    strength = draw(streams("exposure"), "scene.exposure")
    irradiance *= np.float32(strength / max(float(np.quantile(irradiance.max(-1), 0.995)), 1e-12))
    image = record(streams, irradiance, np.ones(3), LINEAR, ("noise",))
    measured, error = measure_ranges(
        streams, ranges, image, _RANGING if "gaps" in names else ())
    declared = _declared(streams("told"), names, rig.lamps)
    return Night(
        image, measured, error, focal, water.clear_water,
        lighting_parameters(declared, daylight is not None), beta)


def _draw_rig(
    rng: np.random.Generator, names: tuple[str, ...], particles: Array
) -> by_lamps.Rig:
    lamps = by_lamps.draw_lamps(rng)
    # Clear water hardly scatters.
    scattering = particles * np.array([draw(rng, "lamps.albedo") for _ in range(3)])
    beams = {"cosine beam": by_lamps.cosine_beam, "rimmed beam": by_lamps.rimmed_beam}
    beam = next((beams[name] for name in names if name in beams), gaussian_beam)
    phase = by_lamps.two_terms() if "two terms" in names else phase_table(
        FOURNIER_FORAND if FOURNIER_FORAND in names else HENYEY_GREENSTEIN)
    return by_lamps.Rig(lamps, scattering, phase, beam)


def _declared(
    rng: np.random.Generator, names: tuple[str, ...], lamps: tuple[Lamp, ...]
) -> tuple[Lamp, ...]:
    """Return the lamps as declared, with their errors."""
    if "misplaced" in names:
        lamps = misplaced(lamps, _SHIFT, _TURN, int(rng.integers(1 << 31)))
    if "beam angle" in names:
        wider = draw(rng, "lamps.beam_error")
        lamps = tuple(
            replace(lamp, beam_angle=min(lamp.beam_angle * wider, 350.0)) for lamp in lamps)
    if "unequal" in names:
        mean = np.mean([lamp.power for lamp in lamps], axis=0)
        powers = [draw(rng, "lamps.power_error") * mean for _ in lamps]
        lamps = tuple(
            replace(lamp, power=vector(p))
            for lamp, p in zip(lamps, powers, strict=True))
    return lamps


def _patches(rng: np.random.Generator, rays: Array, ranges: Map) -> Map:
    """Factor of reflectance that varies over metres of the scene, (H, W, 1) float32."""
    points = rays * np.where(np.isfinite(ranges), ranges, 1.0)[..., np.newaxis]
    total = np.zeros(ranges.shape)
    for _ in range(_WAVES):
        wave = rng.standard_normal(3)
        wave *= 2.0 * math.pi / draw(rng, "lamps.patch") / np.linalg.norm(wave)
        total += np.sin(points @ wave + rng.uniform(0.0, 2.0 * math.pi))
    total *= draw(rng, "lamps.patchiness") / math.sqrt(0.5 * _WAVES)
    return np.exp(total).astype(np.float32)[..., np.newaxis]
