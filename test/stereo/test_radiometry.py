# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The right camera's gain, on pairs whose gain is known."""

import numpy as np
import pytest
from scenes import codes, patches, stereo_pair

from uw_visibility.optics.transfer import from_linear
from uw_visibility.stereo.radiometry import right_gain

GAIN = np.array([1.3, 0.8, 1.05])


def pair(gain=GAIN, transfer="linear", dtype=np.uint8, disparity=7.5, noise=0.01, seed=0):
    """A textured pair of one disparity, and points spread over it."""
    rng = np.random.default_rng(seed)
    left, right = stereo_pair(patches(rng.uniform(0.1, 0.6, (15, 30, 3)), 8), disparity, 200)
    images = [codes(i + noise * rng.standard_normal(i.shape), dtype, transfer)
              for i in (left, right * gain)]
    u, v = np.meshgrid(np.arange(0, 200, 5), np.arange(0, 120, 5))
    points = np.stack((u.ravel(), v.ravel(), np.full(u.size, disparity)), axis=1)
    return *images, points.astype(np.float32)


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("disparity", [8.0, 7.5, 7.25])
def test_gain_is_found(transfer, dtype, disparity):
    # The right image shows at column u - d what the left one shows at u.
    left, right, points = pair(transfer=transfer, dtype=dtype, disparity=disparity)
    np.testing.assert_allclose(right_gain(left, right, points, transfer), GAIN, rtol=0.01)


def test_parts_of_a_pixel_count_where_light_rises_to_one_side():
    rise = np.exp(0.03 * (np.arange(240) % 48))
    columns = np.arange(200)
    left = np.tile(0.1 * rise[:200, None], (120, 1, 3))
    right = np.tile(0.1 * np.sqrt(rise[columns + 4] * rise[columns + 5])[:, None], (120, 1, 3))
    images = [from_linear(image, "linear", np.uint16) for image in (left, right)]
    _, _, points = pair(disparity=4.5)
    np.testing.assert_allclose(right_gain(*images, points, "linear"), 1.0, atol=0.003)


@pytest.mark.parametrize("deep", [0, 1])
def test_one_view_may_have_16_bits_and_the_other_8(deep):
    """As small copies of which one is noisy."""
    *images, points = pair()
    images[deep] = np.multiply(images[deep], 257, dtype=np.uint16)
    np.testing.assert_allclose(right_gain(*images, points, "linear"), GAIN, rtol=0.01)


def test_equal_cameras_have_a_gain_of_one():
    left, right, points = pair(gain=1.0)
    np.testing.assert_allclose(right_gain(left, right, points, "linear"), 1.0, atol=0.004)


def test_wrong_matches_do_not_matter():
    left, right, points = pair()
    points[::4, 2] += 40
    np.testing.assert_allclose(right_gain(left, right, points, "linear"), GAIN, rtol=0.03)


def test_a_saturated_channel_counts_only_where_it_is_not():
    left, right, points = pair(gain=np.array([2.0, 1.0, 1.0]))
    assert (right == 255).mean() > 0.05
    np.testing.assert_allclose(right_gain(left, right, points, "linear"), [2, 1, 1], rtol=0.02)


def test_grey_images_have_one_gain():
    left, right, points = pair(gain=1.2)
    found = right_gain(left[..., 0].copy(), right[..., 0].copy(), points, "linear")
    assert found.shape == (1,)
    assert found[0] == pytest.approx(1.2, rel=0.01)


@pytest.mark.parametrize("count", [0, 5])
def test_too_few_points_tell_nothing(count):
    left, right, points = pair()
    np.testing.assert_array_equal(right_gain(left, right, points[:count], "linear"), 1.0)


def test_black_tells_nothing():
    left, right, points = pair()
    np.testing.assert_array_equal(right_gain(left // 64, right // 64, points, "linear"), 1.0)
