# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Decay of contrast with range."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.water.daylight.contrast import contrast_course, decay, fuse_decays
from uw_visibility.water.daylight.surfaces import surface_statistics

BETA = np.array([0.4, 0.2, 0.15])
ALL = np.ones(3, bool)
IRRADIANCE = (np.arange(256) / 255).astype(np.float32)


def course(distance: np.ndarray, trend: np.ndarray) -> np.ndarray:
    """Contrast over range of a scene whose texture changes so much per deviation of range."""
    place = (distance - distance.mean()) / distance.std()
    return 0.1 * np.exp(-BETA[:, np.newaxis] * distance + np.outer(trend, place))


def test_the_veil_does_not_matter():
    rng = np.random.default_rng(0)
    ranges = np.linspace(2.0, 8.0, 240, dtype=np.float32)[:, np.newaxis] * np.ones((1, 320))
    texture = rng.random((240, 320, 3))
    left = np.exp(-BETA * ranges[..., np.newaxis])
    found = []
    for veil in (0.1, 0.5):
        light = 0.4 * texture * left + veil * (1.0 - left)
        image = np.round(255 * light).astype(np.uint8)
        statistics = surface_statistics(
            image, ranges.astype(np.float32), np.ones((1, 1), bool), IRRADIANCE, (2.0, 8.0))
        found.append(decay(*contrast_course(statistics, np.full(3, 0.29)), ALL))
    for one in found:
        np.testing.assert_allclose(one.attenuation, BETA, atol=0.02)


def test_deviation_holds_scenes_whose_texture_changes_over_range():
    """By a quarter per deviation of range, in all channels, and 6 % in each."""
    rng = np.random.default_rng(1)
    distance, count = np.geomspace(2.0, 8.0, 20), np.full(20, 500.0)
    scores, differences = [], []
    for _ in range(200):
        trend = rng.normal(0.0, 0.25) + rng.normal(0.0, 0.06, 3)
        found = decay(distance, count, course(distance, trend), ALL)
        error, covariance = found.attenuation - BETA, found.covariance
        scores.append(error / np.sqrt(np.diag(covariance)))
        variance = covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1]
        differences.append((error[0] - error[1]) / np.sqrt(variance))
    for score in (np.ravel(scores), np.array(differences)):
        assert (np.abs(score) < 2.0).mean() > 0.9
        assert np.sqrt((score**2).mean()) > 0.7


def test_bins_that_scatter_widen_the_deviation():
    rng = np.random.default_rng(2)
    distance, count = np.geomspace(2.0, 8.0, 20), np.full(20, 500.0)
    smooth = course(distance, np.zeros(3))
    scattered = smooth * np.exp(rng.normal(0.0, 1.0, 20))
    quiet, loud = (decay(distance, count, c, ALL) for c in (smooth, scattered))
    assert (np.diag(loud.covariance) > 1.5 * np.diag(quiet.covariance)).all()


@pytest.mark.parametrize("bins", [2, 4])
def test_few_bins_tell_nothing(bins):
    distance = np.linspace(2.0, 4.0, bins)
    assert decay(distance, np.full(bins, 500.0), course(distance, np.zeros(3)), ALL) is None


def test_two_decays_of_one_scene_are_no_surer_than_one():
    distance, count = np.geomspace(2.0, 8.0, 20), np.full(20, 500.0)
    one = decay(distance, count, course(distance, np.zeros(3)), ALL)
    both = fuse_decays(one, one)
    np.testing.assert_allclose(both.covariance, one.covariance)
    assert fuse_decays(None, one) is one
    assert fuse_decays(one, None) is one
