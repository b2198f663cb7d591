# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Open water has no matches, although the prior favours a disparity there."""

import numpy as np
import pytest

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.stereo.elas import Matcher


@pytest.mark.parametrize(("fall", "codes"), [(0.0, 1.5), (0.8, 0.5), (0.8, 0.3), (0.3, 0.0)])
def test_a_floor_is_matched_and_the_noise_of_the_water_above_it_is_not(
    texture, contrast_of, fall, codes
):
    """Noise is independent, up to that of a small camera; the veil falls by some codes per row."""
    rng = np.random.default_rng(0)
    floor = texture((100, 240)).astype(float) * 0.2
    views = []
    for shift in (0, 12):
        view = np.tile(40.0 + fall * np.arange(100.0, -100.0, -1.0)[:, np.newaxis], 220)
        view[100:] = floor[:, shift : 220 + shift]
        view += rng.normal(0, codes, view.shape)
        views.append(np.round(view).clip(0, 255).astype(np.uint8))
    matcher = Matcher((200, 220), (0, 50), StereoConfig(), Workers(2))
    for side, view in enumerate((contrast_of(views[0]), contrast_of(views[1]))):
        matcher.describe_view(side, view)
    disparity = matcher.dense_disparity(matcher.support_points()).disparity
    assert np.isfinite(disparity[:70]).mean() < 0.02
    assert np.isfinite(disparity[115:, 20:]).mean() > 0.95


def test_a_blank_patch_on_a_surface_keeps_the_surface(texture, contrast_of):
    """The patch has no texture, but is surrounded by it."""
    wide = texture((160, 260))
    wide[60:84, 120:144] = 200
    left, right = wide[:, :240].copy(), wide[:, 12:252].copy()
    matcher = Matcher(left.shape, (0, 50), StereoConfig(), Workers(1))
    for side, view in enumerate((contrast_of(left), contrast_of(right))):
        matcher.describe_view(side, view)
    disparity = matcher.dense_disparity(matcher.support_points()).disparity
    np.testing.assert_allclose(disparity[60:84, 120:144], 12, atol=1)
