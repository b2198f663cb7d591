# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What is assumed is named, and images like video are recognised."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from uw_visibility.config.assumptions import assumptions, like_video
from uw_visibility.config.schema import PipelineConfig


@pytest.mark.parametrize("encoding, like", [
    ("rgb8", True), ("bgr8", True), ("8UC3", True), ("yuv422_yuy2", True), ("uyvy", True),
    ("bayer_rggb8", False), ("mono8", False), ("rgb16", False)])
def test_video_is_8_bit_colour_or_compressed(encoding: str, like: bool) -> None:
    assert like_video(SimpleNamespace(encoding=encoding)) is like
    assert like_video(SimpleNamespace(format="png"))


def test_what_is_told_is_not_called_assumed() -> None:
    values = PipelineConfig().to_parameters()
    text = assumptions(values, ["camera.response"], [0.12])
    assert "transfer linear (assumed; --transfer srgb for video), " in text
    assert "spectral response nikon_d5100, " in text
    assert text.endswith(", baseline 0.12 m.")
    assert "baseline 0.12 to 0.2 m" in assumptions(values, [], [0.12, 0.2])
