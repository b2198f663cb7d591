# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Effects that the light model leaves out, each at some levels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from uw_visibility.errors import InputError
from uw_visibility_lab.simulation.camera import CameraEffects, Sensor
from uw_visibility_lab.simulation.frame import Effects
from uw_visibility_lab.simulation.water import WaterEffects

CONTROL = "none"
"""Name of the cases in water that obeys the model, which are counted apart."""


@dataclass(frozen=True)
class Level:
    """A scene, water and camera as they are, and what the estimator is told of them."""

    label: str  # its name among those of the effect
    water: WaterEffects = WaterEffects()  # how the water departs from the model's
    disturbances: Effects = Effects()  # marine snow
    camera: CameraEffects = CameraEffects()  # how the camera departs from a linear one
    sensor: Sensor = Sensor()  # noise
    range_scale: float = 1.0  # what true ranges are multiplied by, as a wrong calibration does
    contrast: float = 1.0  # what contrast of the scene is multiplied by: 1 as it is, 0 one grey
    # mean attenuations of grey particles instead of the study's, 1/m
    attenuations: tuple[float, ...] | None = None
    # what the estimator is told, by names of parameters
    parameters: dict[str, Any] = field(default_factory=dict)


def _grey(ratio: float) -> tuple[float, float, float]:
    return (ratio, ratio, ratio)


EFFECTS: dict[str, tuple[Level, ...]] = {
    CONTROL: (Level("the model's water"),),
    "veil": (
        *(Level(f"B/W {r:g}", WaterEffects(veil=_grey(r))) for r in (0.2, 0.4, 0.7, 1.2)),
        Level("B/W 0.3 0.5 0.6", WaterEffects(veil=(0.3, 0.5, 0.6))),
    ),
    "spectrum": (
        *(
            Level(f"Jerlov {name}", WaterEffects(water_type=name), attenuations=(0.0,))
            for name in ("IB", "II", "III", "1C", "3C", "5C")
        ),
        Level("clear water", WaterEffects(water_type="clear")),
    ),
    "spectrum, dim veil": tuple(
        Level(
            f"Jerlov {name}, B/W 0.4", WaterEffects(water_type=name, veil=_grey(0.4)),
            attenuations=(0.0,),
        )
        for name in ("IB", "II", "1C", "3C")
    ),
    "dissolved matter": tuple(
        Level(f"a_y(440) {a:g} 1/m", WaterEffects(water_type="clear", cdom=a)) for a in (0.1, 0.4)
    ),
    "coloured particles": tuple(
        Level(f"γ {g:g}", WaterEffects(water_type="clear", particle_slope=g)) for g in (1.0, 2.0)
    ),
    "uneven channels": (
        Level("blue + 0.15 1/m", WaterEffects(channel_attenuation=(0.0, 0.0, 0.15))),
        Level("red + 0.2 1/m", WaterEffects(channel_attenuation=(0.2, 0.0, 0.0))),
    ),
    "forward scattering": tuple(
        Level(f"{b:g} px/m", WaterEffects(blur=b)) for b in (0.2, 0.6)
    ),
    "layer": tuple(
        Level(f"+ {a:g} 1/m below", WaterEffects(layer=a, layer_height=0.8)) for a in (0.1, 0.4)
    ),
    "plume": tuple(
        Level(f"+ {a:g} 1/m in a half", WaterEffects(plume=a)) for a in (0.1, 0.3)
    ),
    "light by direction": (
        *(Level(f"veil ± {g / 2:g}", WaterEffects(veil_gradient=g)) for g in (0.3, 0.8)),
        *(Level(f"scene ± {g / 2:g}", WaterEffects(light_gradient=g)) for g in (0.4, 1.0)),
    ),
    "bright snow": tuple(
        Level(f"{share:.0%}, {b:g} x the veil", disturbances=Effects(share, 0.0, b))
        for share, b in ((0.02, 2.0), (0.1, 3.0))
    ),
    "transfer": (
        Level("sRGB taken for linear", camera=CameraEffects(transfer="srgb")),
        Level("linear taken for sRGB", parameters={"camera.transfer": "srgb"}),
        Level(
            "sRGB, as told", camera=CameraEffects(transfer="srgb"),
            parameters={"camera.transfer": "srgb"},
        ),
    ),
    "white balance": (
        Level("gains 1.3 1 0.8", camera=CameraEffects(white_balance=(1.3, 1.0, 0.8))),
        Level("gains 0.8 1 1.4", camera=CameraEffects(white_balance=(0.8, 1.0, 1.4))),
        Level("automatic", camera=CameraEffects(automatic_white_balance=True)),
    ),
    "vignetting": tuple(
        Level(f"{v:.0%} in the corners", camera=CameraEffects(vignetting=v))
        for v in (0.15, 0.3, 0.5)
    ),
    "colour filter": (Level("Bayer", camera=CameraEffects(bayer=True)),),
    "compression": tuple(
        Level(f"JPEG {q}", camera=CameraEffects(jpeg=q)) for q in (90, 60)
    ),
    "video camera": (
        Level(
            "Bayer, automatic white balance, sRGB, JPEG 80",
            camera=CameraEffects("srgb", automatic_white_balance=True, bayer=True, jpeg=80),
            parameters={"camera.transfer": "srgb"},
        ),
    ),
    "noise": tuple(
        Level(f"{codes:g} codes", sensor=Sensor.gaussian(codes)) for codes in (2.0, 4.0)
    ),
    "range scale": tuple(
        Level(f"ranges x {scale:g}", range_scale=scale) for scale in (0.75, 0.9, 1.25)
    ),
    "flat sand": tuple(
        Level(f"contrast x {c:g}", contrast=c) for c in (0.1, 0.3)
    ),
}
"""Levels of each effect, by the names that tables and `--effects` use."""


def chosen(names: Sequence[str]) -> dict[str, tuple[Level, ...]]:
    """Return the effects of these names, or all."""
    for name in names:
        if name not in EFFECTS:
            raise InputError(f"no effect {name!r}: give one of {', '.join(EFFECTS)}")
    return {name: levels for name, levels in EFFECTS.items() if not names or name in names}
