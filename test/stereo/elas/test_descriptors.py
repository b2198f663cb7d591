# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What descriptors keep and what they drop."""

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.stereo.elas.descriptors import MIDDLE, Descriptors


def describe(grey, gain=1.0 / 256):
    """Return the descriptors of a grey image as (H, W, 16) int."""
    descriptors = Descriptors(grey.shape)
    descriptors.compute(grey, np.full(grey.shape, gain, np.float32), Workers(1))
    return descriptors.values.reshape(*grey.shape, 16).astype(int)


def test_a_constant_image_has_no_response():
    assert (describe(np.full((12, 14), 3000, np.uint16)) == MIDDLE).all()


def test_horizontal_and_vertical_ramps_respond_in_their_own_part():
    """A ramp of 2 levels a pixel: Sobel gives 16 levels, halved 8."""
    ramp = np.tile(np.arange(14, dtype=np.uint16) * 512, (12, 1))
    across = describe(ramp)[4, 6] - MIDDLE
    np.testing.assert_array_equal(across, [8] * 11 + [0] * 5)
    down = describe(np.ascontiguousarray(ramp.T))[6, 4] - MIDDLE
    np.testing.assert_array_equal(down, [0] * 11 + [8] * 5)


def test_brightness_is_dropped_and_gain_undoes_contrast(texture):
    grey = texture((20, 24)).astype(np.uint16) * 64
    expected = describe(grey)
    np.testing.assert_array_equal(describe(grey + np.uint16(5000)), expected)
    quarter = grey // 4
    difference = describe(quarter * 4) - describe(quarter, gain=4.0 / 256)
    assert np.abs(difference).max() <= 1


def test_a_shifted_image_has_shifted_descriptors(texture):
    wide = texture((20, 40)).astype(np.uint16) * 64
    left, right = describe(wide[:, :30].copy()), describe(wide[:, 7:37].copy())
    # Away from the border's repeats.
    np.testing.assert_array_equal(left[:, 10:27], right[:, 3:20])


def test_strong_edges_clip_and_do_not_wrap():
    step = np.zeros((10, 12), np.uint16)
    step[:, 6:] = 65535
    values = describe(step)
    assert values.max() == 255
    assert values[5, 5, 6] == 255
