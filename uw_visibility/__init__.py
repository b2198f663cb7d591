# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Underwater visibility, colour and stereo from a stereo camera."""

from uw_visibility.config import PipelineConfig
from uw_visibility.pipeline import Pipeline
from uw_visibility.result import FrameResult
from uw_visibility.stereo.rig import StereoRig

__all__ = ["FrameResult", "Pipeline", "PipelineConfig", "StereoRig"]
