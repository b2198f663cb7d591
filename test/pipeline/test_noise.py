# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Where noise leaves the coarse part of a scene only, it is matched by that."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scenes import blurred, in_water, row_ranges, stereo_pair

from uw_visibility import Pipeline, PipelineConfig, StereoRig
from uw_visibility.images.jpeg import jpeg_chroma
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.pipeline import second_step
from uw_visibility.pipeline.result import FrameResult
from uw_visibility_lab.evaluation.degrade import load_scene
from uw_visibility_lab.evaluation.metrics import bad_fraction, correct_fraction
from uw_visibility_lab.simulation.camera import Sensor

HEIGHT, WIDTH, DISPARITY = 360, 640, 40
WATER = [0.55, 0.4, 0.35]
RIG = StereoRig(600.0, 0.4, (319.5, 179.5))


def pair(
    noise: float, rig: StereoRig = RIG, steps: tuple[int, ...] = (DISPARITY // 2, DISPARITY)
) -> tuple[np.ndarray, np.ndarray]:
    """Walls above one another, the uppermost at 12 m and the last at 6 m, with texture of 4 px."""
    disparity = np.repeat(steps, HEIGHT // len(steps))
    generator = np.random.default_rng(11)
    wide = blurred(generator.normal(size=(HEIGHT, WIDTH + DISPARITY, 3)), 4.0)
    wide = np.clip(0.5 + 0.2 * wide / wide.std(), 0.0, 1.0)
    sides = stereo_pair(wide, disparity, WIDTH)
    ranges = row_ranges(rig, disparity, WIDTH)
    views = (in_water(side, ranges, WATER, [0.7] * 3) for side in sides)
    left, right = (
        np.clip(np.round(view + generator.normal(0.0, noise, view.shape)), 0, 255).astype(np.uint8)
        for view in views
    )
    return left, right


TRUTH = np.full((HEIGHT, WIDTH), float(DISPARITY), np.float32)
TRUTH[: HEIGHT // 2] /= 2


def process(
    left: np.ndarray, right: np.ndarray, rig: StereoRig = RIG, threads: int = 1, **options: Any
) -> FrameResult:
    config = PipelineConfig.from_parameters({"stereo.max_disparity": 95, "threads": threads})
    return Pipeline(rig, config).process(left, right, enhance=(), **options)


def test_faint_coarse_texture_in_noise_is_matched(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = pair(2.0)
    found = process(left, right)
    assert found.disparity.shape == found.stereo.confidence.shape == (HEIGHT, WIDTH)
    correct = correct_fraction(found.disparity, TRUTH)
    assert correct > 0.7
    monkeypatch.setattr(second_step, "matching_scale", lambda *arguments: 1)
    assert correct > correct_fraction(process(left, right).disparity, TRUTH) + 0.2


def test_what_a_codec_took_counts_as_noise() -> None:
    """JPEG leaves no noise, and of faint gradients the coarse ones."""
    near = StereoRig(600.0, 0.2, RIG.principal_point)
    quality = [cv2.IMWRITE_JPEG_QUALITY, 75]
    data = [cv2.imencode(".jpg", side[..., ::-1], quality)[1] for side in pair(0.0, near)]
    left, right = (np.ascontiguousarray(cv2.imdecode(d, 1)[..., ::-1]) for d in data)
    told, untold = (
        correct_fraction(process(left, right, near, colour=colour).disparity, TRUTH)
        for colour in (jpeg_chroma(data[0].tobytes()), None)
    )
    assert told > untold + 0.1


def test_noise_that_jpeg_left_is_reckoned_with(shared_data: Path) -> None:
    """JPEG takes the fine part of noise, and smoothed gradients hold the coarse one."""
    scene = load_scene(shared_data / "middlebury" / "dolls")
    kappa = clear_water_attenuation(load_response("nikon_d5100"))
    quality = [cv2.IMWRITE_JPEG_QUALITY, 90]
    left, right = (
        np.ascontiguousarray(
            cv2.imdecode(cv2.imencode(".jpg", side[..., ::-1], quality)[1], 1)[..., ::-1])
        for side in scene.degraded(0.2, 2.0, kappa, Sensor.gaussian(2.0)))
    found = process(left, right, scene.rig).disparity
    # As gradients of the scene they gave 0.49 and 0.27, semi-global matching 0.53 and 0.27.
    assert correct_fraction(found, scene.disparity_left) > 0.57
    assert bad_fraction(found, scene.disparity_left) < 0.25


def test_a_coarser_scale_gives_the_same_bits_whatever_the_threads() -> None:
    one, three = (process(*pair(2.0), threads=threads) for threads in (1, 3))
    np.testing.assert_array_equal(one.disparity, three.disparity)
    np.testing.assert_array_equal(one.stereo.confidence, three.stereo.confidence)
    assert one.timing_ms["reduction"] > 0


def test_doubtful_matches_tell_nothing_of_the_water_asked_for_confidence_or_not() -> None:
    # Of two walls cues may disagree, whatever else is told; five make a course over range.
    left, right = pair(2.0, steps=(20, 24, 28, 33, 40))
    rated, unrated = process(left, right), process(left, right, confidence=False)
    np.testing.assert_array_equal(rated.water.attenuation, unrated.water.attenuation)
    np.testing.assert_array_equal(rated.disparity, unrated.disparity)
    assert unrated.stereo.confidence is None
    off = np.abs(rated.water.attenuation - WATER) / rated.water.attenuation_stddev
    assert (off < 3.0).all()
