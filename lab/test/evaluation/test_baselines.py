# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The peers: they do what a user would expect of them, and run as in the figures quoted."""

import cv2
import numpy as np
import pytest
from scenes import blurred, codes, stereo_pair, texture

from uw_visibility_lab.evaluation import baselines, metrics
from uw_visibility_lab.evaluation.degrade import load_scene


def shifted_pair(shift: int, colour: bool = True) -> tuple[np.ndarray, np.ndarray]:
    shape = (80, 220, 3) if colour else (80, 220)
    return stereo_pair(codes(blurred(texture(shape), 0.8)), shift)


@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("match", [baselines.semi_global_matching, baselines.equalised_matching])
def test_matches_a_shifted_pair(match, colour: bool) -> None:  # type: ignore[no-untyped-def]
    left, right = shifted_pair(9, colour)
    disparity = match(left, right, 20)
    assert disparity.dtype == np.float32
    inside = disparity[:, 40:-5]
    assert np.isnan(disparity[:, :5]).all()
    assert (np.abs(inside - 9) <= 0.5).mean() > 0.95


def test_equalisation_uses_the_whole_scale() -> None:
    random = np.random.default_rng(1)
    dull = random.integers(90, 130, (64, 96, 3)).astype(np.uint8)
    full = baselines.equalise_channels(dull)
    assert full.min() == 0
    assert full.max() == 255
    enhanced = baselines.equalise_adaptively(dull)
    assert metrics.lab(enhanced)[..., 0].std() > 1.5 * metrics.lab(dull)[..., 0].std()
    assert enhanced.dtype == np.uint8


def test_adaptive_equalisation_keeps_a_grey_image_grey() -> None:
    ramp = np.tile(np.arange(80, 144, dtype=np.uint8), (64, 1))
    grey = np.dstack([ramp] * 3)
    enhanced = baselines.equalise_adaptively(grey).astype(int)
    assert np.abs(enhanced - enhanced[..., :1]).max() <= 2


def test_clear_water_figures_on_aloe(shared_data) -> None:  # type: ignore[no-untyped-def]
    scene = load_scene(shared_data / "middlebury" / "aloe")
    size = (640, 480)
    left, right = (
        cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        for image in (scene.left, scene.right)
    )
    truth = cv2.resize(scene.disparity_left, size, interpolation=cv2.INTER_NEAREST)
    truth *= 640 / scene.left.shape[1]
    disparity = baselines.semi_global_matching(left, right, 128)
    assert metrics.correct_fraction(disparity, truth) == pytest.approx(0.657, abs=0.01)
    assert 1 - metrics.matched_fraction(disparity) == pytest.approx(0.297, abs=0.01)
