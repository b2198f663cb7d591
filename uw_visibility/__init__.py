# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Underwater visibility, colour and stereo from a stereo camera."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uw_visibility.config.schema import PipelineConfig
    from uw_visibility.pipeline.parts import estimate_water, match
    from uw_visibility.pipeline.pipeline import Pipeline
    from uw_visibility.pipeline.result import FrameResult
    from uw_visibility.stereo.rig import StereoRig

    __version__: str

__all__ = [
    "FrameResult", "Pipeline", "PipelineConfig", "StereoRig", "estimate_water", "match",
]

_HOMES = {
    "FrameResult": "pipeline.result",
    "Pipeline": "pipeline.pipeline",
    "PipelineConfig": "config.schema",
    "StereoRig": "stereo.rig",
    "estimate_water": "pipeline.parts",
    "match": "pipeline.parts",
}


def __getattr__(name: str) -> Any:
    """Import an attribute's module at first access.

    All imports take a second of processor time, which help texts, refused options and
    the start of ROS do without: the wheels of rclpy restart the interpreter.
    """
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            value = version(__name__)
        except PackageNotFoundError:
            value = "unknown"
    elif name in _HOMES:
        value = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value
