# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Text on assumptions about camera and light, which images do not show."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

# Parameters that the text names, with their titles.
_ASSUMED = {
    "camera.transfer": "transfer",
    "camera.white_reference": "white at the surface",
    "camera.response": "spectral response",
    "camera.vignetting": "vignetting",
    "assessment.water_type": "water above the camera",
}
ASK_TRANSFER = (
    "The images are compressed or 8-bit colour, as video and JPEG are, whose pixels are usually "
    "sRGB. They are taken as linear, since the transfer is not set: give --transfer srgb, or "
    "--transfer linear (parameter camera.transfer).")


def like_video(message: Any) -> bool:
    """Return whether an image message is like video: compressed, or RGB or YUV of 8 bit."""
    return hasattr(message, "format") or message.encoding.lower().startswith(
        ("rgb8", "bgr8", "rgba8", "bgra8", "8uc3", "uyvy", "yuyv", "yuv"))


def assumptions(
    parameters: Mapping[str, Any], told: Collection[str], baselines: Collection[float] = ()
) -> str:
    """Return a sentence on the camera and the light that an estimate assumes.

    told: names of the parameters that the user set; others have their defaults.
    baselines: smallest and largest distance of the cameras by their calibration, m.
    """
    parts = []
    for name, title in _ASSUMED.items():
        text, given = _text(parameters[name]), name in told
        if name == "camera.vignetting" and parameters["camera.flat_field"]:
            text, given = "from the flat field", True
        hint = "; --transfer srgb for video" if name == "camera.transfer" else ""
        parts.append(f"{title} {text}" if given else f"{title} {text} (assumed{hint})")
    if baselines:
        parts.append(f"baseline {' to '.join(f'{each:.4g}' for each in baselines)} m")
    return f"Camera and light: {', '.join(parts)}."


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    return " : ".join(f"{number:g}" for number in value) if any(value) else "none"
