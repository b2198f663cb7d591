# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Random scenes to render: water, a camera, and the sea floor in front of it, by seed.

The floor is a reef of the ray caster as a mesh, with the resolution of one camera.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Map
from uw_visibility_lab.simulation.camera import Pose, StereoCamera, Triple
from uw_visibility_lab.simulation.lamps import Lamp
from uw_visibility_lab.simulation.phase_functions import FOURNIER_FORAND, HENYEY_GREENSTEIN
from uw_visibility_lab.simulation.raycast import FLOOR, look_at, on_floor
from uw_visibility_lab.simulation.scene import Scene, reef
from uw_visibility_lab.simulation.shapes import CAPSULE

WAVELENGTHS = (600.0, 540.0, 460.0)
"""Of the channels R, G, B, nm; each is taken as monochromatic."""

WATER_ABSORPTION = np.array([0.2224, 0.0474, 0.00979])
"""Of pure water at `WAVELENGTHS`, 1/m. Pope and Fry 1997, doi 10.1364/AO.36.008710, table 3."""

BEAM = (0.07, 0.5)
"""Limits of the channels' beam attenuation, 1/m, in which estimators are tested (issue 30)."""

ALBEDO = (0.2, 0.85)
"""Limits of the channels' single-scattering albedo; low in red, where water itself absorbs."""


class Kind(NamedTuple):
    """Kind of scene: its objects, and the camera's tilt."""

    stream: int  # number of the stream of random numbers
    tilt: tuple[float, float]  # limits of the camera's tilt below the horizon, degrees
    boulders: float  # boulders, corals: number per square metre
    corals: float


KINDS = {
    "boulders": Kind(0, (5.0, 60.0), 0.25, 0.0),
    # Open water remains in view.
    "reef": Kind(2, (0.0, 25.0), 0.11, 0.28),
}

SECTOR = np.pi / 4.0
"""Half angle of the finely meshed sector in front of the camera, rad."""

RINGS, SPOKES = 400, 560
"""Size of the floor's mesh."""

FINENESS = (2, 60)
"""Least and largest number of subdivisions of an object's mesh over a right angle."""

CLEARANCE = 0.6
"""Least distance of objects from the camera, m; nearer ones are left out."""

DULL = (0.4, 0.9)
"""Limits of a factor of the ground's reflectance: sand has different brightness by place."""

FIELD_OF_VIEW, BASELINE = 60.0, 0.12
"""Horizontal, degrees; distance of the cameras, m."""


@dataclass(frozen=True)
class Water:
    """Homogeneous water."""

    absorption: Triple  # absorption, scattering: RGB, 1/m
    scattering: Triple
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
class Description:
    """All that determines an image."""

    kind: str  # one of `KINDS`
    seed: int  # of geometry, textures and the tracer's samples
    water: Water  # the same everywhere
    depth: float  # of the camera, m
    altitude: float  # of the camera over the floor below it, m
    tilt: float  # of the camera below the horizon, degrees
    # radiance of the sea's surface from below, RGB, the same in all directions
    daylight: Triple = (1.0, 1.0, 1.0)
    # none by day; power is radiant intensity on the axis, in units of the sea surface's radiance
    lamps: tuple[Lamp, ...] = ()

    @property
    def pose(self) -> Pose:
        """Pose of the left camera."""
        return Pose((0.0, 0.0, self.altitude), tilt=math.radians(self.tilt))


def camera_of(width: int, height: int) -> StereoCamera:
    """Return the cameras for an image size in px."""
    half = math.tan(math.radians(FIELD_OF_VIEW) / 2.0)
    return StereoCamera(width, height, width / (2.0 * half), BASELINE)


def draw_water(random: np.random.Generator) -> Water:
    """Draw a water: pure water, dissolved matter, and particles that scatter and absorb.

    Dissolved matter falls by e^(-0.014 (λ - 440 nm)) (Bricaud et al. 1981, doi
    10.4319/lo.1981.26.1.0043), scattering as λ^-η with η in 0 .. 1 (Boss et al. 2001, doi
    10.1364/AO.40.004885). Waters beyond `BEAM` or `ALBEDO` are drawn again.
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
        _triple(absorption), _triple(scattering),
        FOURNIER_FORAND if measured else HENYEY_GREENSTEIN, round(float(asymmetry), 4))


def _triple(values: Array) -> Triple:
    red, green, blue = (round(float(v), 6) for v in values)
    return red, green, blue


def draw_scene(seed: int, kind: str, lamps: int = 0) -> Description:
    """Draw a scene.

    seed: 0 or more.
    kind: one of `KINDS`.
    lamps: 0 for daylight; otherwise number of lamps beside the camera, at night.
    Returns the same for the same arguments.
    Raises `InputError` for an unknown kind.
    """
    if kind not in KINDS:
        raise InputError(f"no kind of scene {kind!r}: give one of {', '.join(sorted(KINDS))}")
    random = np.random.default_rng([seed, KINDS[kind].stream])
    water = draw_water(random)
    depth = math.exp(random.uniform(math.log(1.5), math.log(15.0)))
    tilt = random.uniform(*KINDS[kind].tilt)
    # At a tilt of 60 degrees ranges are about the altitude, at 0 degrees several times that.
    altitude = random.uniform(1.0, 1.8) + random.uniform(0.0, 2.0) * tilt / 60.0
    description = Description(
        kind, seed, water, round(depth, 3), round(altitude, 3), round(tilt, 2))
    if lamps:
        offsets = np.linspace(-0.5, 0.5, lamps) if lamps > 1 else np.array([0.4])
        description = replace(
            description, daylight=(0.0, 0.0, 0.0),
            lamps=tuple(Lamp((float(x), -0.1, 0.0)) for x in offsets))
    return description


def ground_of(description: Description) -> Mesh:
    """Return the mesh of a scene, all of it below the sea's surface."""
    kind = KINDS[description.kind]
    scene = reef(description.seed, 0.0, boulders=kind.boulders, corals=kind.corals)
    # The altitude is that over the floor below the camera.
    level = on_floor(scene, scene.heights, 0.0, 0.0)
    ground = mesh_of(scene, np.array([0.0, 0.0, level + description.altitude]))
    height = ground.vertices[:, 2] - level
    ground.vertices[:, 2] = np.minimum(height, description.altitude + description.depth - 0.3)
    dull = np.random.default_rng([description.seed, 77, kind.stream]).uniform(*DULL)
    return replace(ground, reflectance=ground.reflectance * np.float32(dull))


@dataclass(frozen=True)
class Mesh:
    """Triangle mesh."""

    vertices: Array  # (N, 3) float64; x ahead of the camera, y to its left, z up, m
    faces: Array  # (M, 3) uint32
    reflectance: Map  # (N, 3); RGB, 0 .. 1


def mesh_of(scene: Scene, eye: Array) -> Mesh:
    """Return floor and objects as a mesh, for a camera above x = y = 0 that looks ahead.

    Capsules become ellipsoids of the same length.

    eye: the camera's position, (3,), m.
    """
    points, spacing = polar_grid(0.2, 60.0, RINGS, SPOKES)
    parts, faces, met = [points], [grid_faces(RINGS, SPOKES)], [np.full(len(points), FLOOR)]
    steps, count = [spacing], len(points)
    for index, row in enumerate(scene.shapes):
        centre, axes, half, bound = row[1:4], row[4:13].reshape(3, 3), row[13:16], row[16]
        away = float(np.linalg.norm(centre - eye))
        if away - bound < CLEARANCE:
            continue
        if row[0] == CAPSULE:
            half = half + np.array([0.0, 0.0, half[0]])
        subdivisions = int(np.clip(bound / away * 250.0, *FINENESS))
        unit, corners = sphere(subdivisions)
        parts.append(centre + (unit * half) @ axes)
        faces.append(corners + count)
        met.append(np.full(len(unit), index))
        steps.append(np.full(len(unit), 1.6 * bound / subdivisions))
        count += len(unit)
    vertices = np.concatenate(parts)
    reflectance = np.zeros((count, 3), np.float32)
    _paint(scene, eye, np.concatenate(met), np.concatenate(steps), vertices, reflectance)
    return Mesh(vertices, np.concatenate(faces).astype(np.uint32), reflectance)


@njit(nogil=True, error_model="numpy")
def _paint(
    scene: Scene, eye: Any, met: Any, spacing: Any, vertices: Any, reflectance: Any
) -> None:
    """Set the height of the floor's vertices, and the reflectance of all vertices."""
    seen = np.zeros(9)
    for k in range(len(vertices)):
        x, y = vertices[k, 0], vertices[k, 1]
        if met[k] == FLOOR:
            vertices[k, 2] = on_floor(scene, scene.heights, x, y)
        ray = vertices[k] - eye
        ray /= np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
        look_at(
            scene, met[k], x, y, vertices[k, 2], spacing[k], (ray[0], ray[1], ray[2]), seen)
        for channel in range(3):
            reflectance[k, channel] = seen[3 + channel]


def grid_faces(rows: int, columns: int) -> Array:
    """Return the triangles of a grid of vertices in row-major order, (M, 3)."""
    corner = np.arange((rows - 1) * columns).reshape(rows - 1, columns)[:, :-1].ravel()
    return np.concatenate([
        np.stack([corner, corner + columns, corner + 1], -1),
        np.stack([corner + 1, corner + columns, corner + columns + 1], -1),
    ])


def polar_grid(
    nearest: float, farthest: float, rings: int, rays: int,
) -> tuple[Array, Array]:
    """Points of the plane with a spacing proportional to distance, as that of pixels.

    nearest, farthest: radii, m.
    rings, rays: numbers; an eighth of the rays is outside of `SECTOR`.
    Returns `points`, (rings × rays, 3) float64, z = 0, m; `spacing`, (rings × rays,) float64,
    distance of neighbours, m.
    """
    radius = np.geomspace(nearest, farthest, rings)
    seen = rays - rays // 8
    angle = np.concatenate([
        np.linspace(-SECTOR, SECTOR, seen),
        np.linspace(SECTOR, 2.0 * np.pi - SECTOR, rays - seen + 1)[1:]])
    r, a = np.meshgrid(radius, angle, indexing="ij")
    points = np.stack([r * np.cos(a), r * np.sin(a), np.zeros_like(r)], -1).reshape(-1, 3)
    wide = np.gradient(angle)[None, :]
    step = np.maximum(np.log(farthest / nearest) / rings, wide)
    return points, (r * step).ravel()


@lru_cache(maxsize=FINENESS[1])
def sphere(subdivisions: int) -> tuple[Array, Array]:
    """Unit sphere with so many subdivisions of a right angle: vertices (N, 3), faces (M, 3)."""
    rows, columns = 2 * subdivisions + 1, 4 * subdivisions + 1
    down, around = np.meshgrid(
        np.linspace(0.0, np.pi, rows), np.linspace(0.0, 2.0 * np.pi, columns), indexing="ij")
    points = np.stack([
        np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)], -1)
    return points.reshape(-1, 3), grid_faces(rows, columns)
