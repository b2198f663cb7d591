# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Statistical correction of a survey: what the closed form makes uneven comes out even."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.evaluation.survey_statistics import SurveyStatistics

SHAPE = (96, 160)
RATES = np.array([0.9, 0.5, 0.3])


def survey(frames: int, veil: float = 0.0) -> tuple[list[np.ndarray], list[np.ndarray], list]:
    """Grey ground of random brightness under a lamp to the left, at changing altitude."""
    random = np.random.default_rng(3)
    pattern = np.linspace(1.0, 0.3, SHAPE[1])[np.newaxis, :, np.newaxis]
    images, ranges, grounds = [], [], []
    for k in range(frames):
        altitude = 1.5 + 1.5 * (0.5 - 0.5 * np.cos(0.7 * k))
        distance = np.full(SHAPE, altitude) + random.uniform(-0.1, 0.1)
        ground = np.repeat(random.uniform(0.2, 0.6, (6, 10, 1)), 16, axis=0).repeat(16, axis=1)
        light = pattern * np.exp(-RATES * distance[..., np.newaxis])
        images.append((ground * light + veil).astype(np.float32))
        ranges.append(distance.astype(np.float32))
        grounds.append(ground)
    return images, ranges, grounds


def spread(images: list[np.ndarray], grounds: list[np.ndarray]) -> np.ndarray:
    """Standard deviation over mean of ground that is alike, RGB."""
    alike = np.abs(np.array(grounds)[..., 0] - 0.45) < 0.02
    values = np.array(images)[alike]
    return np.asarray(values.std(axis=0) / values.mean(axis=0))


def test_light_that_falls_with_range_and_place_is_evened() -> None:
    images, ranges, grounds = survey(100)
    statistics = SurveyStatistics.fit(images, ranges)
    corrected = [statistics.correct(*pair) for pair in zip(images, ranges, strict=True)]
    before, after = spread(images, grounds), spread(corrected, grounds)
    assert (before > 0.3).all()
    assert (after < 0.5 * before).all()
    # Grey on average, as bright as the survey at its middle range.
    means = np.mean(corrected, axis=(0, 1, 2))
    np.testing.assert_allclose(means, means.mean(), rtol=0.01)
    np.testing.assert_allclose(means, statistics.target_mean, rtol=0.05)


def test_the_fitted_rate_is_that_of_the_decay() -> None:
    images, ranges, _ = survey(60)
    a, b, c = SurveyStatistics.fit(images, ranges).curve
    middle = 2.25
    slope = a * b * np.exp(-b * middle) / (a * np.exp(-b * middle) + c)
    np.testing.assert_allclose(slope.mean(axis=(0, 1)), RATES, rtol=0.25)


def test_a_veil_is_taken_off_with_the_mean() -> None:
    images, ranges, grounds = survey(80, veil=0.1)
    statistics = SurveyStatistics.fit(images, ranges)
    corrected = [statistics.correct(*pair) for pair in zip(images, ranges, strict=True)]
    dark, bright = np.array(grounds) < 0.3, np.array(grounds) > 0.5

    def contrast(some: list[np.ndarray]) -> float:
        values = np.array(some)[..., 2:]
        return float(values[bright].mean() / values[dark].mean())

    assert contrast(corrected) > 1.3 * contrast(images)


def test_unknown_ranges_stay_unknown() -> None:
    images, ranges, _ = survey(10)
    ranges[0][:, :40] = np.nan
    corrected = SurveyStatistics.fit(images, ranges).correct(images[0], ranges[0])
    assert np.isnan(corrected[:, :40]).all()
    assert np.isfinite(corrected[:, 40:]).all()


def test_too_little_is_refused() -> None:
    images, ranges, _ = survey(4)
    with pytest.raises(InputError, match="4 frames"):
        SurveyStatistics.fit(images, ranges)
    with pytest.raises(InputError, match="ranges"):
        SurveyStatistics.fit(images * 2, [np.full(SHAPE, np.nan, np.float32)] * 8)
