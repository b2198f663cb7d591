# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Colours of the report can be told apart, by the colour-blind too, and read."""

from __future__ import annotations

import itertools
import re

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uw_visibility.optics.transfer import to_linear
from uw_visibility.replay.report.gallery import gradient
from uw_visibility.replay.report.svg import DATA, SURFACES

# Machado, Oliveira and Fernandes 2009, doi:10.1109/TVCG.2009.113, severity 1.0, linear RGB.
SIMULATED = {
    "normal": np.eye(3),
    "protanopia": np.array([
        [0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998]]),
    "deuteranopia": np.array([
        [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881]]),
    "tritanopia": np.array([
        [1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900]]),
}
# CIE76 differences: 2.3 is just noticeable; lines on a page need more.
LEAST_DIFFERENCE = 15.0


def linear(colours: list[str]) -> NDArray[np.float32]:
    """Colours as linear RGB, (n, 3)."""
    codes = [[int(colour[k:k + 2], 16) for k in (1, 3, 5)] for colour in colours]
    return to_linear(np.array([codes], np.uint8), "srgb")[0]


def lab(light: NDArray[np.float32], sight: str) -> NDArray[np.float32]:
    """CIE Lab of colours as they are seen."""
    seen = np.clip(light @ SIMULATED[sight].T, 0.0, 1.0).astype(np.float32)
    return cv2.cvtColor(seen[np.newaxis], cv2.COLOR_LRGB2Lab)[0]


def contrast(first: str, second: str) -> float:
    """Contrast ratio of WCAG 2."""
    high, low = sorted(
        (linear([first, second]) @ [0.2126, 0.7152, 0.0722] + 0.05).tolist(), reverse=True)
    return high / low


@pytest.mark.parametrize("sight", SIMULATED)
@pytest.mark.parametrize("mode", ["light", "dark"])
def test_lines_are_told_apart(sight: str, mode: str) -> None:
    shades = [getattr(shade, mode) for shade in (*DATA.values(), SURFACES["ink"])]
    seen = lab(linear(shades), sight)
    for first, second in itertools.combinations(range(len(shades)), 2):
        difference = float(np.linalg.norm(seen[first] - seen[second]))
        assert difference > LEAST_DIFFERENCE, (shades[first], shades[second], difference)


@pytest.mark.parametrize("mode", ["light", "dark"])
def test_text_and_lines_stand_out_from_what_is_behind(mode: str) -> None:
    surfaces = {name: getattr(shade, mode) for name, shade in SURFACES.items()}
    for behind in ("paper", "raised", "warning", "partial", "changed"):
        for text in ("ink", "muted", "link"):
            assert contrast(surfaces[text], surfaces[behind]) >= 4.5, (text, behind)
    for shade in DATA.values():
        assert contrast(getattr(shade, mode), surfaces["paper"]) >= 3.0


@pytest.mark.parametrize("sight", SIMULATED)
def test_disparity_rises_in_lightness_for_every_sight(sight: str) -> None:
    codes = np.array(re.findall(r"rgb\((\d+), (\d+), (\d+)\)", gradient()), int).astype(np.uint8)
    lightness = lab(to_linear(codes[np.newaxis], "srgb")[0], sight)[:, 0]
    assert np.all(np.diff(lightness) > 1.5)
