# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What is rendered: a water, a camera in it, and the sea floor before it, drawn by a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility_lab.simulation.camera import Pose, StereoCamera, Triple
from uw_visibility_lab.simulation.lamps import Lamp
from uw_visibility_lab.simulation.phase_functions import FOURNIER_FORAND, HENYEY_GREENSTEIN
from uw_visibility_lab.simulation.raycast import on_floor
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.tracer.shapes import Mesh, mesh_of

WAVELENGTHS = (600.0, 540.0, 460.0)
"""Of the channels R, G, B, nm; each is taken as monochromatic."""

WATER_ABSORPTION = np.array([0.2224, 0.0474, 0.00979])
"""Of pure water at `WAVELENGTHS`, 1/m. Pope and Fry 1997, doi 10.1364/AO.36.008710, table 3."""

BEAM = (0.07, 0.5)
"""Beam attenuation of any channel, 1/m: what the tracer's judgement is asked for (issue 30)."""

ALBEDO = (0.2, 0.85)
"""Single-scattering albedo of any channel; lower in red, where water itself absorbs."""


class Kind(NamedTuple):
    """What stands before the camera, and how that looks at it."""

    stream: int  # of random numbers
    tilt: tuple[float, float]  # limits of the camera's tilt below the horizon, degrees
    boulders: float  # boulders, corals: of a square metre
    corals: float


KINDS = {
    "boulders": Kind(0, (5.0, 60.0), 0.25, 0.0),
    # Open water stays in view.
    "reef": Kind(2, (0.0, 25.0), 0.11, 0.28),
}

DULL = (0.4, 0.9)
"""Limits of the factor of a ground's reflectance: sand is not of one brightness everywhere."""

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
    """All that decides an image."""

    kind: str  # one of `KINDS`
    seed: int  # of geometry, textures and the tracer's samples
    water: Water  # the same everywhere
    depth: float  # of the camera, m
    altitude: float  # of the camera over the floor below it, m
    tilt: float  # of the camera below the horizon, degrees
    # radiance of the sea's surface from below, RGB, the same in all directions
    daylight: Triple = (1.0, 1.0, 1.0)
    # none by day; their power is radiant intensity on the axis, where the surface's radiance is 1
    lamps: tuple[Lamp, ...] = ()

    @property
    def pose(self) -> Pose:
        """Pose of the left camera."""
        return Pose((0.0, 0.0, self.altitude), tilt=math.radians(self.tilt))


def camera_of(width: int, height: int) -> StereoCamera:
    """Return the cameras, of images of a size in px."""
    half = math.tan(math.radians(FIELD_OF_VIEW) / 2.0)
    return StereoCamera(width, height, width / (2.0 * half), BASELINE)


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
        _triple(absorption), _triple(scattering),
        FOURNIER_FORAND if measured else HENYEY_GREENSTEIN, round(float(asymmetry), 4))


def _triple(values: Array) -> Triple:
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
    random = np.random.default_rng([seed, KINDS[kind].stream])
    water = draw_water(random)
    depth = math.exp(random.uniform(math.log(1.5), math.log(15.0)))
    tilt = random.uniform(*KINDS[kind].tilt)
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


def ground_of(description: Description) -> Mesh:
    """Return the mesh of a scene, below the surface and at least 0.5 m from the camera."""
    kind = KINDS[description.kind]
    scene = reef(description.seed, 0.0, boulders=kind.boulders, corals=kind.corals)
    # The altitude is that over the floor below the camera.
    level = on_floor(scene, scene.heights, 0.0, 0.0)
    ground = mesh_of(scene, np.array([0.0, 0.0, level + description.altitude]))
    height = ground.vertices[:, 2] - level
    ground.vertices[:, 2] = np.minimum(height, description.altitude + description.depth - 0.3)
    dull = np.random.default_rng([description.seed, 77, kind.stream]).uniform(*DULL)
    return replace(ground, reflectance=ground.reflectance * np.float32(dull))
