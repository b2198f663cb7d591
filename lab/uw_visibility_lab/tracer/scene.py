# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What is rendered: a water, a camera in it, and the sea floor before it, drawn by a seed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility_lab.simulation.phase_functions import FOURNIER_FORAND, HENYEY_GREENSTEIN
from uw_visibility_lab.tracer.shapes import (
    Shape,
    fractal,
    grid_faces,
    painted,
    polar_grid,
    rotation,
    sphere,
)

Colour = tuple[float, float, float]

WAVELENGTHS = (600.0, 540.0, 460.0)
"""Of the channels R, G, B, nm; each is taken as monochromatic."""

WATER_ABSORPTION = np.array([0.2224, 0.0474, 0.00979])
"""Of pure water at `WAVELENGTHS`, 1/m. Pope and Fry 1997, doi 10.1364/AO.36.008710, table 3."""

BEAM = (0.07, 0.5)
"""Beam attenuation of any channel, 1/m: what the tracer's judgement is asked for (issue 30)."""

ALBEDO = (0.2, 0.85)
"""Single-scattering albedo of any channel; lower in red, where water itself absorbs."""

TILTS = {"boulders": (5.0, 60.0), "reef": (0.0, 25.0)}
"""Of the camera below the horizon, degrees: open water stays in view of a reef."""

FIELD_OF_VIEW, BASELINE = 60.0, 0.12
"""Horizontal, degrees; distance of the cameras, m."""


@dataclass(frozen=True)
class Water:
    """Homogeneous water."""

    absorption: Colour  # absorption, scattering: RGB, 1/m
    scattering: Colour
    phase: str = HENYEY_GREENSTEIN  # phase function: this, or Fournier and Forand's
    asymmetry: float = 0.85  # mean cosine of Henyey-Greenstein's function

    @property
    def beam_attenuation(self) -> Array:
        """Absorption and scattering together, (3,), 1/m."""
        return np.add(self.absorption, self.scattering)

    @property
    def albedo(self) -> Array:
        """Single-scattering albedo, (3,)."""
        return np.asarray(self.scattering) / self.beam_attenuation


@dataclass(frozen=True)
class Lamp:
    """Spot light that moves with the camera."""

    # position, direction: in the left camera's frame (x right, y down, z forward), m
    position: Colour
    direction: Colour = (0.0, 0.0, 1.0)
    beam_angle: float = 90.0  # full angle, degrees
    intensity: Colour = (1.0, 1.0, 1.0)  # RGB, on the axis, where the surface's radiance is 1


@dataclass(frozen=True)
class Description:
    """All that decides an image."""

    kind: str  # one of `KINDS`
    seed: int  # of geometry, textures and the tracer's samples
    water: Water  # the same everywhere
    depth: float  # of the camera, m
    altitude: float  # of the camera over the floor below it, m
    tilt: float  # of the camera below the horizon, degrees
    # radiance of the sea's surface from below, RGB, the same in all directions
    daylight: Colour = (1.0, 1.0, 1.0)
    lamps: tuple[Lamp, ...] = ()  # none by day
    field_of_view: float = FIELD_OF_VIEW
    baseline: float = BASELINE


def draw_water(random: np.random.Generator) -> Water:
    """Draw a water: pure water, dissolved matter, and particles that scatter and absorb.

    Dissolved matter falls by e^(-0.014 (λ - 440 nm)) (Bricaud et al. 1981, doi
    10.4319/lo.1981.26.1.0043), scattering as λ^-η with η in 0 .. 1 (Boss et al. 2001, doi
    10.1364/AO.40.004885). What is beyond `BEAM` or `ALBEDO` is drawn again.
    """
    relative = np.array(WAVELENGTHS)
    while True:
        dissolved = np.exp(random.uniform(*np.log([0.003, 0.3])))
        particles = np.exp(random.uniform(*np.log([0.04, 0.4])))
        slope = random.uniform(0.0, 1.0)
        absorbed = random.uniform(0.02, 0.12)
        scattering = particles * (relative / 550.0) ** -slope
        absorption = (WATER_ABSORPTION + dissolved * np.exp(-0.014 * (relative - 440.0))
                      + absorbed * particles)
        beam = absorption + scattering
        albedo = scattering / beam
        if (BEAM[0] <= beam.min() and beam.max() <= BEAM[1]
                and ALBEDO[0] <= albedo.min() and albedo.max() <= ALBEDO[1]):
            break
    measured = random.random() < 0.25
    asymmetry = random.uniform(0.77, 0.92)
    return Water(
        _colour(absorption), _colour(scattering),
        FOURNIER_FORAND if measured else HENYEY_GREENSTEIN, round(float(asymmetry), 4))


def _colour(values: Array) -> Colour:
    red, green, blue = (round(float(v), 6) for v in values)
    return red, green, blue


def draw_scene(seed: int, kind: str, lamps: int = 0) -> Description:
    """Draw a scene.

    seed: 0 or more.
    kind: one of `KINDS`.
    lamps: 0 for daylight; else lamps beside the camera, by night.
    Returns the same for the same arguments.
    Raises `InputError` for an unknown kind.
    """
    if kind not in KINDS:
        raise InputError(f"no kind of scene {kind!r}: give one of {', '.join(sorted(KINDS))}")
    random = np.random.default_rng([seed, KINDS[kind][0]])
    water = draw_water(random)
    depth = math.exp(random.uniform(math.log(1.5), math.log(15.0)))
    tilt = random.uniform(*TILTS[kind])
    # From 60 degrees down ranges are about the altitude, from the horizontal several times that.
    altitude = random.uniform(1.0, 1.8) + random.uniform(0.0, 2.0) * tilt / 60.0
    description = Description(
        kind, seed, water, round(depth, 3), round(altitude, 3), round(tilt, 2))
    if lamps:
        offsets = np.linspace(-0.5, 0.5, lamps) if lamps > 1 else np.array([0.4])
        description = replace(
            description, daylight=(0.0, 0.0, 0.0),
            lamps=tuple(Lamp((float(x), -0.1, 0.0)) for x in offsets))
    return description


def shapes_of(description: Description) -> list[Shape]:
    """Return the meshes of a scene, below the surface and at least 0.8 m from the camera."""
    stream, make = KINDS[description.kind]
    shapes = make(np.random.default_rng([description.seed, 77, stream]), description)
    top = description.altitude + description.depth - 0.3
    for shape in shapes:
        shape.vertices[:, 2] = np.minimum(shape.vertices[:, 2], top)
    return shapes


def _sand(random: np.random.Generator) -> Array:
    """Palette of sand and gravel: yellowish grey of 0.15 to 0.45, (3, 3)."""
    level = random.uniform(0.15, 0.45, (3, 1))
    return np.asarray(level * np.array([1.0, 0.92, 0.78]) * random.uniform(0.93, 1.07, (3, 3)))


def _rock(random: np.random.Generator) -> Array:
    """Palette of overgrown rock: brown, grey, olive, and a light crust, (4, 3)."""
    palette = np.array([
        [0.14, 0.11, 0.08], [0.20, 0.19, 0.17], [0.10, 0.12, 0.06], [0.42, 0.38, 0.36]])
    return np.asarray(palette * random.uniform(0.6, 1.5, (4, 1)) * random.uniform(0.9, 1.1, (4, 3)))


def _growth(random: np.random.Generator) -> Array:
    """Palette of a reef: rock with coralline red, sponge yellow, pale coral, (6, 3)."""
    palette = np.array([[0.36, 0.14, 0.18], [0.45, 0.36, 0.10], [0.50, 0.46, 0.40]])
    return np.concatenate([
        _rock(random)[:3], palette * random.uniform(0.7, 1.3, (3, 1))])


def _floor(
    random: np.random.Generator, relief: float, ripples: float, palette: Array,
    fall: Callable[[Array], Array] | None = None,
) -> tuple[Shape, Callable[[Array], Array]]:
    """Return the floor, level 0 below the camera, and its height over places (N, 3)."""
    seed = int(random.integers(1 << 20))
    length = random.uniform(0.12, 0.3)
    course = random.uniform(0.0, np.pi)

    def height(points: Array, spacing: Array | float = 0.0) -> Array:
        flat = points * [1.0, 1.0, 0.0]
        rough = relief * fractal(flat, seed, 4.0, 6, 0.45, spacing)
        along = flat[:, 0] * np.cos(course) + flat[:, 1] * np.sin(course)
        along = along + 0.15 * fractal(flat, seed + 1, 1.5, 2)
        carried = np.clip(length / np.maximum(2.0 * np.asarray(spacing), 1e-9) - 1.0, 0.0, 1.0)
        rough += ripples * carried * np.sin(2.0 * np.pi * along / length)
        return np.asarray(rough if fall is None else rough + fall(flat))

    points, spacing = polar_grid(0.2, 60.0, 400, 560)
    base = float(height(np.zeros((1, 3)))[0])
    vertices = points.copy()
    vertices[:, 2] = height(points, spacing) - base
    colour = painted(vertices, palette, seed + 2, random.uniform(0.5, 1.5),
                     random.uniform(0.03, 0.08), random.uniform(0.2, 0.5), spacing)
    return Shape(vertices, grid_faces(400, 560), colour), lambda at: height(at) - base


def _place(random: np.random.Generator, size: float, sight: float) -> Array:
    """Draw a place on the floor ahead, so far that a thing of a size is 1 m clear of the camera."""
    distance = size + 1.2 + sight * random.random() ** 1.3
    angle = random.uniform(-0.75, 0.75)
    return np.array([[distance * np.cos(angle), distance * np.sin(angle), 0.0]])


def _boulder(
    random: np.random.Generator, centre: Array, size: float, palette: Array,
) -> Shape:
    """Return a rough stone about a centre (3,)."""
    subdivisions = int(np.clip(size / np.linalg.norm(centre) * 250.0, 16, 60))
    vertices, faces = sphere(subdivisions)
    seed = int(random.integers(1 << 20))
    spacing = size * 1.6 / subdivisions
    swell = 1.0 + 0.35 * fractal(vertices, seed, 1.6, 6, 0.5, 1.6 / subdivisions)
    stretch = random.uniform(0.6, 1.3, 3) * [1.0, 1.0, 0.8]
    turned = (vertices * swell[:, None] * stretch) @ rotation(
        np.array([0.0, 0.0, 1.0]), random.uniform(0.0, 6.3)).T
    placed = centre + size * turned
    colour = painted(placed, palette, seed + 1, size * random.uniform(0.5, 1.2),
                     random.uniform(0.03, 0.08), random.uniform(0.3, 0.6), spacing)
    return Shape(placed, faces, colour)


def _boulders(random: np.random.Generator, description: Description) -> list[Shape]:
    floor, height = _floor(
        random, random.uniform(0.1, 0.5), random.uniform(0.0, 0.025), _sand(random))
    palette = _rock(random)
    shapes = [floor]
    for _ in range(int(random.integers(14, 40))):
        size = float(np.clip(np.exp(random.normal(-1.1, 0.6)), 0.12, 1.2))
        at = _place(random, size, 11.0)
        at[0, 2] = height(at)[0] + random.uniform(-0.2, 0.5) * size
        shapes.append(_boulder(random, at[0], size, palette))
    return shapes


def _reef(random: np.random.Generator, description: Description) -> list[Shape]:
    side = 1.0 if random.random() < 0.5 else -1.0
    slope = random.uniform(0.15, 0.5)

    def fall(flat: Array) -> Array:
        # Towards the open side the floor falls away.
        return np.asarray(-slope * np.logaddexp(0.0, -side * flat[:, 1] * 2.0) / 2.0)

    floor, height = _floor(random, random.uniform(0.2, 0.5), 0.0, _growth(random), fall)
    near, far = random.uniform(1.1, 2.0), random.uniform(-1.5, 2.0)
    rows, columns = 220, 600
    top = min(random.uniform(1.5, 5.0), description.altitude + description.depth - 0.5)
    x = 0.4 * (26.0 / 0.4) ** np.linspace(0.0, 1.0, columns)
    up, along = np.meshgrid(np.linspace(0.0, 1.0, rows), x, indexing="ij")
    overhang = random.uniform(0.2, 0.9)
    # The wall runs from beside the camera towards its far end, and leans over.
    across = near + far * (along / 12.0) - overhang * np.sin(np.pi * np.clip(up * 1.3, 0, 1)) * (
        0.25 + 0.75 * np.clip(along / 4.0, 0.0, 1.0))
    wall = np.stack([along, across, -1.0 + (top + 1.0) * up], -1).reshape(-1, 3)
    spacing = np.maximum(along * np.log(65.0) / columns, (top + 1.0) / rows).ravel()
    seed = int(random.integers(1 << 20))
    rough = fractal(wall, seed, 2.2, 7, 0.5, spacing)
    # Never nearer to the camera's line of sight than 0.5 m.
    wall[:, 1] = np.maximum(wall[:, 1] + 0.45 * rough, 0.5 + 0.02 * wall[:, 0])
    wall[:, 2] += 0.35 * fractal(wall, seed + 1, 1.8, 4, 0.5, spacing) * np.clip(
        up.ravel() * 4.0, 0.0, 1.0)
    # Behind its top edge it goes back, so that no light falls through from behind.
    back = wall.reshape(rows, columns, 3)[-1:] + np.array([0.0, 12.0, -0.3])
    vertices = np.concatenate([wall.reshape(rows, columns, 3), back]).reshape(-1, 3)
    spacing = np.concatenate([spacing, spacing[-columns:]])
    colour = painted(vertices, _growth(random), seed + 2, random.uniform(0.3, 0.9),
                     random.uniform(0.04, 0.1), random.uniform(0.3, 0.6), spacing)
    shapes = [floor, Shape(vertices * [1.0, side, 1.0], grid_faces(rows + 1, columns), colour)]
    palette = _growth(random)
    for _ in range(int(random.integers(14, 30))):
        size = float(np.clip(np.exp(random.normal(-1.4, 0.5)), 0.1, 0.8))
        at = _place(random, size, 9.0)
        at[0, 2] = height(at)[0] + random.uniform(0.0, 0.7) * size
        shapes.append(_boulder(random, at[0], size, palette))
    return shapes


KINDS: dict[str, tuple[int, Callable[[np.random.Generator, Description], list[Shape]]]] = {
    "boulders": (0, _boulders), "reef": (2, _reef)}
"""What stands before the camera, by name, each with random numbers of its own."""
