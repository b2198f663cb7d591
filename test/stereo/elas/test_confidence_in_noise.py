# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Confidence in noise: look-alikes tell a surface from what an edge lent its disparity to."""

import numpy as np
import pytest

from uw_visibility.compute.threads import Workers
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas.confidence_in_noise import drop_doubtful, rate_in_noise
from uw_visibility.stereo.elas.descriptors import BYTES

HEIGHT, WIDTH = 60, 120
# A bright surface right of the edge, and how far it grew over the dark one left of it.
EDGE, GROWN = 60, 8
NEAR, FAR = 20.0, 8.0


def image(noise: float = 0.0) -> ContrastNormalizer:
    """Return two tones, 100 levels apart, with as much noise."""
    shown = ContrastNormalizer((HEIGHT, WIDTH))
    tones = np.where(np.arange(WIDTH) < EDGE, 80.0, 180.0)
    rng = np.random.default_rng(3)
    shown.grey[:] = 256 * (tones + noise * rng.standard_normal((HEIGHT, WIDTH)))
    shown.gain[:] = 1 / 256
    return shown


def rate(disparity: np.ndarray, noise: float = 0.0) -> np.ndarray:
    blank = np.full(HEIGHT * WIDTH * BYTES, 128, np.uint8)
    # The right view agrees with all of it, so that tones alone tell.
    right = np.full((HEIGHT, WIDTH), -1, np.int16)
    return rate_in_noise(disparity, right, (blank, blank), image(noise), Workers(1))


@pytest.mark.parametrize("behind", [np.nan, FAR])
@pytest.mark.parametrize("noise", [0.0, 8.0])
def test_what_grew_over_an_edge_is_doubted(behind: float, noise: float) -> None:
    disparity = np.full((HEIGHT, WIDTH), NEAR, np.float32)
    disparity[:, : EDGE - GROWN] = behind
    confidence = rate(disparity, noise)
    grown = confidence[:, EDGE - GROWN : EDGE - 2]
    own = confidence[:, EDGE + 2 : EDGE + GROWN]
    # Wrong five times as often.
    assert 1 - np.quantile(grown, 0.9) > 5 * (1 - np.quantile(own, 0.1))
    assert (confidence[np.isnan(disparity)] == 0).all()


def test_what_the_right_view_denies_is_doubted() -> None:
    disparity = np.full((HEIGHT, WIDTH), NEAR, np.float32)
    blank = np.full(HEIGHT * WIDTH * BYTES, 128, np.uint8)
    right = np.full((HEIGHT, WIDTH), NEAR, np.int16)
    right[:30] = FAR
    confidence = rate_in_noise(disparity, right, (blank, blank), image(), Workers(1))
    assert confidence[:15, 50:].max() < 0.5 < confidence[45:, 50:].min()


def test_of_a_surface_single_doubtful_pixels_stay_and_regions_go() -> None:
    disparity = np.full((HEIGHT, WIDTH), NEAR, np.float32)
    disparity[:, :10] = np.nan
    confidence = np.where(np.isnan(disparity), 0, 0.9).astype(np.float32)
    confidence[20, 50] = confidence[30:50, 70:100] = 0.2
    drop_doubtful(disparity, confidence, 0.5, Workers(1))
    assert disparity[20, 50] == NEAR
    assert np.isnan(disparity[30:50, 70:100]).all()
    assert np.isnan(disparity[:, :10]).all()
    assert (disparity[:, 40:70] == NEAR).all()


def test_threads_change_no_bit() -> None:
    disparity = np.full((HEIGHT, WIDTH), NEAR, np.float32)
    disparity[:, : EDGE - GROWN] = np.nan
    blank = np.full(HEIGHT * WIDTH * BYTES, 128, np.uint8)
    right = np.full((HEIGHT, WIDTH), 19, np.int16)
    one, three = (
        rate_in_noise(disparity, right, (blank, blank), image(5.0), Workers(threads))
        for threads in (1, 3))
    np.testing.assert_array_equal(one, three)
