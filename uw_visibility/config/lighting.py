# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the light: daylight, or lamps with their positions and beams."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from uw_visibility.config.parameters import parameter
from uw_visibility.errors import InputError

T = TypeVar("T")

Vector = tuple[float, float, float]

MOST_LAMPS = 16
# Least distance of a lamp from the camera, m: close to it, scattered light has no bound.
LEAST_DISTANCE = 0.01
ISOTROPIC = 360.0


class Lamp(NamedTuple):
    """Position, axis, beam and colour of one lamp."""

    position: Vector  # in the left camera's optical frame (x right, y down, z forward), m
    direction: Vector  # axis of the beam in that frame, of length 1
    # full angle between the directions of half the power, degrees: relative power is ``exp(-ln 2 (2
    # θ / beam_angle)²)`` at θ from the axis. 360 for an isotropic lamp.
    beam_angle: float
    colour: Vector  # relative power in R, G, B, as the camera sees it

    @property
    def falloff(self) -> float:
        """Coefficient k of the beam's shape exp(-k θ²), 1/rad²; 0 for an isotropic lamp."""
        return beam_falloff(self.beam_angle)


def beam_falloff(angle: float) -> float:
    """Return `Lamp.falloff` of a beam's full angle, degrees; 0 or 360 for an isotropic lamp."""
    if angle in (0.0, ISOTROPIC):
        return 0.0
    return math.log(2.0) * (2.0 / math.radians(angle)) ** 2


@dataclass(frozen=True)
class LightingConfig:
    """Light of the scene: daylight, the vehicle's lamps, both, or either.

    Raises `InputError` if lamps light the scene and their parameters are inconsistent.
    """

    model: str = parameter(
        "daylight",
        "Light of the scene: daylight, lamps (the vehicle's own, at night or in deep water), "
        "both, or auto: daylight or lamps, decided for each frame.",
        choices=("daylight", "lamps", "both", "auto"),
    )
    positions: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0),
        "Positions of the lamps: x, y, z of each, one after the other, in the left camera's "
        "optical frame (x right, y down, z forward, of the rectified camera). Required for "
        "lamps; see the drawing in docs/lamps.md.",
        unit="m", minimum=-20.0, maximum=20.0, repeats=True,
    )
    directions: tuple[float, ...] = parameter(
        (0.0, 0.0, 1.0),
        "Directions of the lamps: x, y, z of each beam's axis in the same frame, of any length; "
        "three numbers apply to all lamps.",
        minimum=-1e3, maximum=1e3, repeats=True,
    )
    beam_angles: tuple[float, ...] = parameter(
        (90.0,),
        "Full angle of each beam, between the directions of half the power; 0 or 360 for an "
        "isotropic lamp. One number applies to all lamps.",
        unit="degrees", minimum=0.0, maximum=360.0, repeats=True,
    )
    colours: tuple[float, ...] = parameter(
        (1.0, 1.0, 1.0),
        "Relative power of each lamp in R, G, B as the camera sees it; three numbers apply to "
        "all lamps. A factor common to all lamps has no effect.",
        minimum=0.0, maximum=1e3, repeats=True,
    )

    position_stddev: float = parameter(
        0.02, "Standard deviation of each coordinate of the lamps' positions; it is part of "
        "that of the estimates.", unit="m", minimum=0.0, maximum=1.0,
    )
    direction_stddev: float = parameter(
        2.0, "Standard deviation of the lamps' directions.", unit="degrees", minimum=0.0,
        maximum=45.0,
    )

    def __post_init__(self) -> None:
        # Not checked by daylight, since a node's parameters may be set one by one.
        if self.model != "daylight":
            tuple(self.lamps())

    def lamps(self) -> Iterator[Lamp]:
        """Yield the lamps, with axes of length 1.

        Raises `InputError` if the parameters are inconsistent.
        """
        positions = _triples(self.positions)
        count = len(positions)
        if count > MOST_LAMPS:
            raise InputError(
                f"parameter lighting.positions has {count} lamps: give {MOST_LAMPS} at most")
        directions = _for_all("directions", _triples(self.directions), count)
        angles = _for_all("beam_angles", self.beam_angles, count)
        colours = _for_all("colours", _triples(self.colours), count)
        for i, position in enumerate(positions):
            length = math.hypot(*directions[i])
            for name, usable, wanted in (
                ("positions", math.hypot(*position) >= LEAST_DISTANCE,
                 "x, y, z of each lamp in the left camera's frame, in m, outside of that camera"),
                ("directions", length > 0.0, "x, y, z of its beam's axis, not all 0"),
                ("colours", any(colours[i]), "R, G, B of its light, not all 0"),
            ):
                if not usable:
                    raise InputError(
                        f"parameter lighting.{name} has none for lamp {i + 1}: give {wanted}")
            x, y, z = (value / length for value in directions[i])
            yield Lamp(position, (x, y, z), angles[i] or ISOTROPIC, colours[i])


def _triples(values: tuple[float, ...]) -> tuple[Vector, ...]:
    return tuple(
        (values[i], values[i + 1], values[i + 2]) for i in range(0, len(values), 3))


def _for_all(name: str, values: tuple[T, ...], count: int) -> tuple[T, ...]:
    """Return a value for each lamp; a single one applies to all."""
    if len(values) == 1:
        return values * count
    if len(values) != count:
        raise InputError(
            f"parameter lighting.{name} is for {len(values)} lamps, lighting.positions for "
            f"{count}: give one for each lamp, or one for all"
        )
    return values
