# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What an estimate rests on that no image shows, in words."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

# Parameters that are told, with what they say.
_ASSUMED = {
    "camera.transfer": "transfer",
    "camera.white_reference": "white at the surface",
    "camera.response": "spectral response",
    "camera.vignetting": "vignetting",
    "assessment.water_type": "water above the camera",
}
ASK_TRANSFER = (
    "The images are compressed, as video and JPEG are, whose pixels are usually sRGB. They are "
    "taken as linear, because nothing was told: give --transfer srgb, or --transfer linear.")


def assumptions(parameters: Mapping[str, Any], told: Collection[str]) -> str:
    """Name the camera and the light that an estimate assumes.

    Parameters
    ----------
    parameters : mapping of str to object
        Values by the names of parameters.
    told : collection of str
        Names of those that the user gave; the others are defaults.
    """
    parts = []
    for name, title in _ASSUMED.items():
        text, given = _text(parameters[name]), name in told
        if name == "camera.vignetting" and parameters["camera.flat_field"]:
            text, given = "from the flat field", True
        hint = "; --transfer srgb for video" if name == "camera.transfer" else ""
        parts.append(f"{title} {text}" if given else f"{title} {text} (assumed{hint})")
    return f"Camera and light: {', '.join(parts)}."


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    return " : ".join(f"{number:g}" for number in value) if any(value) else "none"
