# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The matcher as a whole."""

import numpy as np
import pytest
from scenes import ReefView

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.stereo.elas import Matcher
from uw_visibility_lab.evaluation.baselines import semi_global_matching
from uw_visibility_lab.evaluation.degrade import load_scene
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.water import Water


def match(pair, contrast_of, disparities=(0, 40), threads=1):
    left, right = pair
    matcher = Matcher(left.shape[:2], disparities, StereoConfig(), Workers(threads))
    for side, view in enumerate((contrast_of(left), contrast_of(right))):
        matcher.describe_view(side, view)
    return matcher.dense_disparity(matcher.support_points())


def step_pair(texture, near=20, far=8):
    """A square in front of a wall, with correct occlusions."""
    wall = texture((120, 240), 1)
    square = texture((60, 80), 2)
    left, right = wall[:, :200].copy(), wall[:, far : 200 + far].copy()
    left[30:90, 70:150] = square
    right[30:90, 70 - near : 150 - near] = square
    truth = np.full(left.shape, far, np.float32)
    truth[30:90, 70:150] = near
    return (left, right), truth


def test_disparities_are_not_drawn_to_whole_pixels(contrast_of):
    """On a reef with all disparities, the error does not depend on the fraction of a pixel."""
    frame = ReefView(StereoCamera(320, 240, 400.0, 0.12), water=Water(0.0, 3.0)).frame()
    pair = frame.left, frame.right

    def bias_by_fraction(disparity):
        error = disparity - frame.disparity_left
        close = np.abs(error) <= 1
        eighth = np.floor(8 * (frame.disparity_left[close] % 1)).astype(int)
        return np.ptp([np.median(error[close][eighth == part]) for part in range(8)])

    ours = bias_by_fraction(match(pair, contrast_of, (0, 63)).disparity)
    peer = bias_by_fraction(semi_global_matching(*pair, 64))
    assert ours < 0.05 < 0.1 < peer


def test_disparities_of_the_right_view_s_first_columns_are_not_too_small(contrast_of):
    frame = ReefView(StereoCamera(320, 240, 400.0, 0.12), water=Water(0.0, 3.0)).frame()
    truth = frame.disparity_left
    error = match((frame.left, frame.right), contrast_of, (0, 63)).disparity - truth
    column = np.arange(320) - truth
    for first in range(4):
        near = error[np.abs(column - first) < 0.5]
        assert np.isfinite(near).mean() > 0.7
        assert abs(np.nanmean(near)) < 0.2


def test_both_sides_of_a_depth_step_are_found(texture, contrast_of):
    pair, truth = step_pair(texture)
    disparity = match(pair, contrast_of).disparity
    matched = np.isfinite(disparity)
    inner = np.zeros_like(matched)
    inner[35:85, 75:145] = True
    inner[:, 10:45] = True
    assert matched[inner].mean() > 0.97
    assert np.mean(np.abs(disparity - truth)[matched & inner] <= 0.5) > 0.99
    # Left of the square the wall is hidden from the right camera.
    assert matched[40:80, 60:68].mean() < 0.1


def test_no_disparity_leads_out_of_the_right_image(texture, contrast_of):
    wall = texture((120, 240), 1)
    found = match((wall[:, :200].copy(), wall[:, 30:230].copy()), contrast_of).disparity
    column = np.broadcast_to(np.arange(200), found.shape)
    matched = np.isfinite(found)
    assert matched[:, 45:].mean() > 0.8
    assert np.all(column[matched] - found[matched] >= 0)


def test_what_the_right_view_does_not_show_is_for_colour_only(texture, contrast_of):
    """A narrow gap is filled from the wall, which the box occludes there."""
    pair, truth = step_pair(texture, near=13, far=8)
    found = match(pair, contrast_of)
    matched = np.isfinite(found.disparity)
    np.testing.assert_array_equal(found.with_occlusions[matched], found.disparity[matched])
    more = np.isfinite(found.with_occlusions) & ~matched
    assert more[40:80, 66:69].mean() > 0.5
    # Most of it has the wall's disparity, the rest that of the box, grown over its edge.
    assert np.mean(np.abs(found.with_occlusions - truth)[more] < 1) > 0.6
    assert more[:, 80:].mean() < 0.01


def test_an_untextured_pair_matches_nothing(contrast_of):
    flat = np.full((96, 160), 120, np.uint8)
    assert np.isnan(match((flat, flat), contrast_of).disparity).all()


def test_threads_do_not_change_a_bit(texture, contrast_of):
    pair, _ = step_pair(texture)
    one, four = match(pair, contrast_of), match(pair, contrast_of, threads=4)
    np.testing.assert_array_equal(one.disparity, four.disparity)
    np.testing.assert_array_equal(one.with_occlusions, four.with_occlusions)
    np.testing.assert_array_equal(one.confidence, four.confidence)


def test_memory_of_one_pair_does_not_leak_into_the_next(texture, contrast_of):
    pair, _ = step_pair(texture)
    other = tuple(np.ascontiguousarray(image[::-1]) for image in pair)
    matcher = Matcher(pair[0].shape, (0, 40), StereoConfig(), Workers(2))

    def run(images):
        for side, view in enumerate((contrast_of(images[0]), contrast_of(images[1]))):
            matcher.describe_view(side, view)
        return matcher.dense_disparity(matcher.support_points()).disparity

    first = run(pair)
    run(other)
    np.testing.assert_array_equal(run(pair), first)


@pytest.mark.parametrize("name", ["art", "dolls", "moebius"])
def test_more_is_right_than_by_semi_global_matching(shared_data, contrast_of, name):
    """On scenes in air with known disparity, at the same search range."""
    scene = load_scene(shared_data / "middlebury" / name)
    left, right = scene.left, scene.right
    ours = match((left, right), contrast_of, (0, 95), threads=2).disparity
    peer = semi_global_matching(left, right, 96)

    def correct(disparity):
        with np.errstate(invalid="ignore"):
            return np.mean((np.abs(disparity - scene.disparity_left) <= 1)[scene.known])

    assert correct(ours) > correct(peer) + 0.03
