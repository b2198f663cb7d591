# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated water: that of the paper, and how real water departs from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uw_visibility.errors import InputError, check_range
from uw_visibility.images.arrays import Array
from uw_visibility.optics.light_model import ambient_light_at_depth
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility_lab.simulation.spectrum import BandAverages, band_averages, spectral_types

RESPONSE = "nikon_d5100"
"""The simulated camera's spectral response: the package's default."""

EXPOSED = 0.8
"""Irradiance of white in the strongest channel with automatic exposure."""

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class WaterEffects:
    """Departures of water from the paper's; the defaults change nothing."""

    # ratio B/W of what the water adds at infinity to what lights the scene, RGB
    veil: Triple = (1.0, 1.0, 1.0)
    # attenuation beyond clear water's and that of grey particles, RGB, 1/m
    channel_attenuation: Triple = (0.0, 0.0, 0.0)
    # ``clear``, or a Jerlov type from IB to 5C: integrates over wavelength, see `band_averages`.
    # None takes one coefficient per channel
    water_type: str | None = None
    # exponent of the particles' spectrum, (550 nm / λ)^γ; with a water type
    particle_slope: float = 0.0
    cdom: float = 0.0  # absorption by dissolved organic matter at 440 nm in 1/m; with a water type
    # forward scattering: standard deviation of a point's image in px per m of range
    blur: float = 0.0
    layer: float = 0.0  # attenuation that grey particles add below ``layer_height`` in 1/m
    layer_height: float = 1.0  # height of the layer's top above the mean sea floor in m
    plume: float = 0.0  # attenuation that grey particles add in a part of the view in 1/m
    plume_share: float = 0.5  # width of that part, at the right, as a share of the image's, 0 .. 1
    # relative change of the veil from the bottom of the image to its top
    veil_gradient: float = 0.0
    light_gradient: float = 0.0  # relative change of the light on the scene from left to right

    def __post_init__(self) -> None:
        """Validate the effects."""
        for name, largest, unit in (
            ("particle_slope", 4.0, ""), ("cdom", 10.0, "1/m"), ("blur", 20.0, "px/m"),
            ("layer", 10.0, "1/m"), ("plume", 10.0, "1/m"), ("plume_share", 1.0, ""),
        ):
            check_range(name.replace("_", " "), getattr(self, name), 0.0, largest, unit)
        for name in ("veil_gradient", "light_gradient"):
            check_range(name.replace("_", " "), getattr(self, name), -1.9, 1.9)
        check_range("layer height", self.layer_height, -1e6, 1e6, "m")
        check_range("ratios of the veil", self.veil, 0.0, 10.0, above=True)
        check_range("channel attenuations", self.channel_attenuation, 0.0, 10.0, "1/m")
        if self.water_type is not None and self.water_type not in spectral_types():
            raise InputError(
                f"no water type {self.water_type!r}: give one of {', '.join(spectral_types())}"
            )
        if self.water_type is None and (self.cdom > 0.0 or self.particle_slope != 0.0):
            raise InputError(
                "dissolved matter and coloured particles have a spectrum: name a water type too, "
                "clear or a Jerlov type"
            )
        if self.water_type is not None and any(self.channel_attenuation):
            raise InputError(
                "a water type has a spectrum: leave out the attenuation by channel, or the type"
            )


@dataclass(frozen=True)
class Water:
    """Water that differs from clear sea water by grey particles, and by its effects."""

    mean_attenuation: float  # attenuation by grey particles α in 1/m, the same in all channels
    depth: float  # depth of the camera in m
    # gain from light to irradiance, where white at the surface is 1; None exposes so that the
    # brighter of white and open water comes to 0.8 in the strongest channel
    exposure: float | None = None
    effects: WaterEffects = WaterEffects()  # how it departs from the paper's

    def __post_init__(self) -> None:
        """Validate attenuation, depth and exposure."""
        check_range("mean attenuation", self.mean_attenuation, 0.0, unit="1/m")
        check_range("depth, positive down,", self.depth, 0.0, unit="m")
        if self.exposure is not None:
            check_range("exposure", self.exposure, 0.0, above=True)

    def attenuation(self) -> Array:
        """Return β in 1/m, RGB, without layer and plume; of a spectrum, that at range zero."""
        bands = self.bands()
        if bands is not None:
            return np.asarray(-bands.log_transmission[1] / bands.path[1])
        clear = clear_water_attenuation(load_response(RESPONSE))
        return np.asarray(clear + self.mean_attenuation + self.effects.channel_attenuation)

    def scene_light(self) -> Array:
        """Return W, which lights the scene at the camera's depth, as irradiance in the image."""
        bands = self.bands()
        light = (
            ambient_light_at_depth(self.attenuation(), self.depth) if bands is None
            else bands.light)
        brightest = (light * np.maximum(self.effects.veil, 1.0)).max()
        gain = EXPOSED / brightest if self.exposure is None else self.exposure
        return np.asarray(gain * light)

    def ambient_light(self) -> Array:
        """Return the veil B at infinity, which open water is seen as; the paper's I∞."""
        return np.asarray(self.scene_light() * self.effects.veil)

    def bands(self) -> BandAverages | None:
        """Return the spectrum as the camera's channels see it, where there is one."""
        effects = self.effects
        if effects.water_type is None:
            return None
        return band_averages(
            effects.water_type, self.depth, self.mean_attenuation, effects.particle_slope,
            effects.cdom, RESPONSE,
        )
