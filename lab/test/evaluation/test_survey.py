# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What a survey tells of colours, and from where it sees its ground."""

from __future__ import annotations

import math

import numpy as np

from uw_visibility_lab.evaluation.survey import pose_of, variation


def test_variation_is_what_light_makes_of_the_same_reflectance() -> None:
    random = np.random.default_rng(1)
    truth = [random.uniform(0.1, 0.9, (96, 128, 3)).astype(np.float32) for _ in range(10)]
    assert (variation(truth, truth) < 1e-6).all()
    gains = np.array([0.8, 1.2] * 5, np.float32)
    flicker = [gain * image for gain, image in zip(gains, truth, strict=True)]
    np.testing.assert_allclose(variation(flicker, truth), 0.2, atol=0.01)
    # A channel by itself, and what is not known or too dark to tell.
    red = [image * np.array([gain, 1, 1], np.float32) for gain, image in zip(
        gains, truth, strict=True)]
    for image, true in zip(red, truth, strict=True):
        image[:16] = np.nan
        true[16:32], image[16:32] = 0.01, 0.9
    np.testing.assert_allclose(variation(red, truth), [0.2, 0.0, 0.0], atol=0.01)


def test_a_survey_sees_its_ground_from_several_heights_and_sides() -> None:
    poses = [pose_of(k, 100) for k in range(100)]
    over = [p for p in poses if abs(p.position[0] - 1.5) < 0.3]
    assert np.ptp([p.position[2] for p in over]) > 1.0
    assert {round(math.cos(p.heading)) for p in over} == {-1, 1}
    assert {p.position[1] for p in over} == {-0.2, 0.2}
