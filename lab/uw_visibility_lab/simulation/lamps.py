# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Lamps of a simulated vehicle, and the light of a scene: daylight, lamps, or both."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uw_visibility.config.lighting import MOST_LAMPS
from uw_visibility.errors import InputError, check_range
from uw_visibility.images.arrays import Array
from uw_visibility_lab.simulation.camera import Triple
from uw_visibility_lab.simulation.phase_functions import HENYEY_GREENSTEIN, phase_table

BEAM = 90.0
"""Full angle of a floodlight's beam at half power, degrees."""

POWER = 1.0
"""Irradiance of white 1 m in front of a lamp in clear water, relative to daylight's at the
surface: that of a strobe in a short exposure."""

STROBES = ("steady", "alternate")

# Positions in the left camera's optical frame (m) and directions: above, and to the sides of
# cameras 0.12 m apart; all point slightly inwards.
_RIGS: dict[int, tuple[tuple[Triple, Triple], ...]] = {
    1: (((0.06, -0.4, 0.0), (0.0, 0.15, 1.0)),),
    2: (
        ((-0.44, -0.2, 0.0), (0.12, 0.06, 1.0)),
        ((0.56, -0.2, 0.0), (-0.12, 0.06, 1.0)),
    ),
    4: (
        ((-0.44, -0.35, 0.0), (0.12, 0.09, 1.0)),
        ((0.56, -0.35, 0.0), (-0.12, 0.09, 1.0)),
        ((-0.44, 0.35, 0.0), (0.12, -0.09, 1.0)),
        ((0.56, 0.35, 0.0), (-0.12, -0.09, 1.0)),
    ),
}


@dataclass(frozen=True)
class Lamp:
    """A lamp, as a point source."""

    position: Triple  # in the left camera's optical frame (x right, y down, z forward), m
    direction: Triple = (0.0, 0.0, 1.0)  # axis of its beam; of any length above 0
    # full angle of the beam at half power in degrees: relative power falls as 2^(−(2θ/beam)²) with
    # the angle θ from the axis. 0 or 360: the same in all directions
    beam_angle: float = BEAM
    # power by channel, RGB: irradiance of a white surface that faces the lamp on its axis, 1 m away
    # in clear water
    power: Triple = (POWER, POWER, POWER)

    def __post_init__(self) -> None:
        check_range("coordinates of a lamp's position", self.position, -1e6, 1e6, "m")
        check_range("length of a lamp's direction", float(np.linalg.norm(self.direction)), 1e-9)
        if self.beam_angle != 0.0:
            check_range(
                "beam of a lamp, unless 0 for all directions,", self.beam_angle, 5.0, 360.0,
                "degrees")
        check_range("powers of a lamp", self.power, 0.0)
        check_range("largest power of a lamp", max(self.power), 0.0, above=True)

    @property
    def axis(self) -> Array:
        """Unit vector along the beam, shape (3,)."""
        direction = np.asarray(self.direction, dtype=np.float64)
        return np.asarray(direction / np.linalg.norm(direction))

    def scaled(self, factor: ArrayLike) -> Lamp:
        """Return the lamp with its power, or that of each channel, multiplied."""
        red, green, blue = (np.asarray(factor) * self.power).tolist()
        return replace(self, power=(red, green, blue))


@dataclass(frozen=True)
class Lighting:
    """Light sources of a scene; by default daylight alone."""

    lamps: tuple[Lamp, ...] = ()  # the vehicle's lamps; daylight alone without any
    daylight: bool = True  # whether there is daylight, too
    # whether surfaces are Lambertian: light falls on a slanted one with the cosine of the angle.
    # Otherwise every surface faces every lamp, as in the paper's model
    shaded: bool = True
    # share of scattering in attenuation, b/β, RGB, 0 .. 1
    scattering_albedo: Triple = (0.6, 0.75, 0.8)
    phase_function: str = HENYEY_GREENSTEIN  # one of `PHASE_FUNCTIONS`
    # ``steady``, or ``alternate``: lamps fire in every second frame only, from the first one on
    strobe: str = "steady"
    # standard deviation of the logarithm of each lamp's power from frame to frame
    jitter: float = 0.0

    def __post_init__(self) -> None:
        check_range("number of lamps", len(self.lamps), 0, MOST_LAMPS)
        if not self.lamps and not self.daylight:
            raise InputError("there is neither daylight nor a lamp: give lamps for a night")
        check_range("shares of the scattering albedo", self.scattering_albedo, 0.0, 1.0)
        phase_table(self.phase_function)
        if self.strobe not in STROBES:
            raise InputError(f"strobe is {self.strobe!r}: give one of {', '.join(STROBES)}")
        check_range("jitter of lamps", self.jitter, 0.0, 1.0)

    def of_frame(self, index: int, seed: int) -> tuple[Lamp, ...]:
        """Return the lamps that light a frame, with their power in it."""
        if self.strobe == "alternate" and index % 2 == 1:
            return ()
        if self.jitter == 0.0:
            return self.lamps
        random = np.random.default_rng([seed, 3])
        factors = np.exp(self.jitter * random.standard_normal(len(self.lamps)))
        return tuple(
            lamp.scaled(factor) for lamp, factor in zip(self.lamps, factors, strict=True))


def default_rig(
    count: int, beam_angle: float = BEAM, power: Triple = (POWER, POWER, POWER)
) -> tuple[Lamp, ...]:
    """Return one, two or four lamps at usual places on a vehicle."""
    if count not in _RIGS:
        raise InputError(
            f"number of lamps is {count}: give {', '.join(map(str, _RIGS))}, or their positions")
    return tuple(Lamp(place, axis, beam_angle, power) for place, axis in _RIGS[count])


def misplaced(lamps: tuple[Lamp, ...], distance: float, angle: float, seed: int
              ) -> tuple[Lamp, ...]:
    """Return the lamps with errors of their poses, as from a wrong calibration.

    Each is moved by a distance, m, and turned by an angle, degrees, in random directions.
    """
    random = np.random.default_rng([seed, 4])
    moved = []
    for lamp in lamps:
        shift, other = random.standard_normal((2, 3))
        position = np.asarray(lamp.position) + distance * shift / np.linalg.norm(shift)
        axis = lamp.axis
        aside = other - (other @ axis) * axis
        aside /= np.linalg.norm(aside)
        turn = math.radians(angle)
        direction = math.cos(turn) * axis + math.sin(turn) * aside
        moved.append(replace(
            lamp, position=tuple(position.tolist()), direction=tuple(direction.tolist())))
    return tuple(moved)


def lighting_parameters(lamps: tuple[Lamp, ...], daylight: bool) -> dict[str, Any]:
    """Return the pipeline's parameters of the lamps, by name.

    Powers are relative to the strongest: vehicles do not know absolute ones.
    """
    if not lamps:
        return {"lighting.model": "daylight"}
    strongest = max(power for lamp in lamps for power in lamp.power)
    return {
        "lighting.model": "both" if daylight else "lamps",
        "lighting.positions": [float(v) for lamp in lamps for v in lamp.position],
        "lighting.directions": [float(v) for lamp in lamps for v in lamp.axis],
        "lighting.beam_angles": [float(lamp.beam_angle) for lamp in lamps],
        "lighting.colours": [float(v / strongest) for lamp in lamps for v in lamp.power],
    }
