# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Explanations of statuses for who was in the water."""

from __future__ import annotations

from uw_visibility.status import Status

MEANINGS = {
    Status.NO_COLOUR: "The images are grey; attenuation by colour needs a colour camera.",
    Status.TOO_FEW_SUPPORT_POINTS: "Hardly anything matched: open water, blur, or too murky.",
    Status.TOO_FEW_OBSERVATIONS: "Too few pixels with a known range.",
    Status.RANGE_SPREAD_TOO_SMALL: "All that is seen is about equally far away, so that the "
    "water's part cannot be told from the scene's: tilt the camera.",
    Status.SATURATED: "Too many pixels at the largest value: shorten the exposure.",
    Status.TOO_DARK: "Too little light: lengthen the exposure, or light the scene.",
    Status.NO_TEXTURE: "The image is one colour.",
    Status.AMBIENT_LIGHT_UNBOUNDED: "Nothing bright or far enough bounds the light of the water.",
    Status.FIT_FAILED: "The light that was seen does not follow the model of one water.",
    Status.NO_DAYLIGHT_COLOUR: "The light has not the colour of daylight at any depth: lamps, or a "
    "camera whose white is not the one that was configured.",
    Status.OTHER_TRANSFER: "Images look encoded the other way than configured: linear or sRGB.",
    Status.UNEVEN_RADIUS: "The image darkens or brightens from its middle outwards, as by the "
    "lens or by lamps.",
    Status.UNEVEN_SIDES: "The halves of the image show different water: a plume, a layer, or light "
    "from one side.",
    Status.CLEARER_THAN_CLEAR_WATER: "The water would be clearer than pure sea water: a camera "
    "setting or the calibration is wrong.",
    Status.CUES_DISAGREE: "Contrast and darkness fade with range at different rates, which no "
    "single water explains.",
    Status.NEGATIVE_DISPARITIES: "Left and right images are exchanged.",
}


def meaning(status: str) -> str:
    """Return a sentence for a status; empty where there is none to add."""
    try:
        return MEANINGS.get(Status(status), "")
    except ValueError:
        return ""
