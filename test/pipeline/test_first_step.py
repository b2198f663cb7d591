# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Step 1 of large images: small copies tell as much, in pixels of the images themselves."""

import cv2
import numpy as np
import pytest
from scenes import ReefView

from uw_visibility import Pipeline, PipelineConfig, StereoRig
from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Image
from uw_visibility.images.view import StereoViews, View
from uw_visibility.pipeline.first_step import CoarseEstimate, FirstStep
from uw_visibility.pipeline.lamps import Estimators
from uw_visibility.pipeline.result import StageClock
from uw_visibility.status import Status
from uw_visibility.stereo.pyramid import Pyramid
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.frame import RenderedFrame
from uw_visibility_lab.simulation.water import Water

CAMERA = StereoCamera(644, 362, 600.0, 0.12)


@pytest.fixture(scope="module")
def frame() -> RenderedFrame:
    return ReefView(CAMERA, water=Water(0.2, 3.0)).frame()


def config_of(parameters: dict[str, float]) -> PipelineConfig:
    return PipelineConfig.from_parameters({"stereo.max_disparity": 64, **parameters})


def pipeline() -> Pipeline:
    return Pipeline(CAMERA.rig, config_of({}))


def coarse_estimate(left: Image, right: Image, **parameters: float) -> CoarseEstimate:
    """What step 1 finds."""
    config = config_of(parameters)
    estimator = Estimators(config, Assessor(config), CAMERA.rig).first
    step = FirstStep(left.shape[:2], CAMERA.rig, config, estimator, Workers(1))
    return step.run(StereoViews(View.of(left), View.of(right)), StageClock())


def test_large_images_are_matched_small_and_told_in_their_own_pixels(
    frame: RenderedFrame,
) -> None:
    coarse = coarse_estimate(frame.left, frame.right)
    assert coarse.disparity.shape == (181, 322)
    u, v, disparity = coarse.points.T
    assert u.max() > 600 and v.max() > 340
    truth = frame.disparity_left[np.round(v).astype(int), np.round(u).astype(int)]
    assert np.nanmedian(np.abs(disparity - truth)) < 0.5
    dense = Pyramid(2, (362, 644)).upsample_disparity(coarse.disparity)
    assert dense.shape == (362, 644)
    assert np.nanmedian(np.abs(dense - frame.disparity_left)) < 1.0


def test_the_water_seen_first_is_near_the_truth(frame: RenderedFrame) -> None:
    coarse = coarse_estimate(frame.left, frame.right)
    np.testing.assert_allclose(coarse.water.attenuation, frame.attenuation, rtol=0.25)


@pytest.mark.parametrize(
    ("parameters", "width"),
    [
        # Too few disparities would be left of a narrow search.
        ({"stereo.max_disparity": 40}, 644),
        # No larger than what step 2 matches.
        ({"stereo.reduction": 3}, 214),
        ({"stereo.reduction": 2}, 322),
    ],
)
def test_small_copies_keep_enough_to_be_matched(
    frame: RenderedFrame, parameters: dict[str, float], width: int
) -> None:
    coarse = coarse_estimate(frame.left, frame.right, **parameters)
    assert coarse.disparity.shape[1] == width


def test_a_hand_is_left_out_at_the_size_of_the_images(frame: RenderedFrame) -> None:
    left, right = (
        cv2.circle(image.copy(), (at, 200), 70, (1, 1, 1), -1)
        for image, at in ((frame.left, 420), (frame.right, 200))
    )
    coarse = coarse_estimate(left, right)
    assert coarse.view.valid is not None and coarse.view.valid.shape == (362, 644)
    assert not coarse.view.valid[140:260, 370:470].any()
    assert coarse.view.valid[:, :250].all()


def test_a_dead_part_of_one_camera_leaves_the_rest_its_matches() -> None:
    turbid = ReefView(CAMERA, water=Water(0.6, 3.0)).frame()
    left = turbid.left.copy()
    left[:, :64] = 0
    whole, rest = (
        len(coarse_estimate(image, turbid.right).points) for image in (turbid.left, left))
    assert rest > 0.8 * whole > 300


def test_a_mask_stays_where_nothing_is_in_the_way(frame: RenderedFrame) -> None:
    mask = np.ones((362, 644), bool)
    mask[:, :40] = False
    result = pipeline().process(frame.left, frame.right, valid=mask)
    dark = frame.left.copy()
    dark[:, :40] = 0
    other = pipeline().process(dark, frame.right, valid=mask)
    np.testing.assert_allclose(result.water.attenuation, other.water.attenuation, rtol=0.02)


def test_what_is_masked_does_not_move_the_estimate(frame: RenderedFrame) -> None:
    mask = np.ones((362, 644), bool)
    mask[:, 560:] = False
    shaded = frame.left.copy()
    shaded[:, 560:] = 0.8 * shaded[:, 560:]
    masked = pipeline().process(shaded, frame.right, valid=mask).water
    plain = pipeline().process(frame.left, frame.right, valid=mask).water
    np.testing.assert_allclose(masked.attenuation, plain.attenuation, rtol=0.02)
    assert (np.abs(masked.attenuation - frame.attenuation) < 2 * masked.attenuation_stddev).all()


def test_exchanged_large_images_are_refused(frame: RenderedFrame) -> None:
    with pytest.raises(InputError, match="exchange left and right"):
        coarse_estimate(frame.right, frame.left)


def test_principal_points_that_make_disparities_negative_are_named(frame: RenderedFrame) -> None:
    """As of a region of interest that is 40 px farther to the right on the left sensor."""
    cx, cy = CAMERA.principal_point
    rig = StereoRig(CAMERA.focal_length, CAMERA.baseline, (cx - 40, cy), (cx, cy))
    with pytest.raises(InputError, match="equal cx, since that of the left is 40 px smaller"):
        Pipeline(rig, config_of({})).process(frame.left[:, 40:], frame.right[:, :-40])
    with pytest.raises(InputError, match=r"exchange left and right$"):
        pipeline().process(frame.right, frame.left)


def test_a_right_image_of_noise_is_no_exchange(frame: RenderedFrame) -> None:
    noise = np.random.default_rng(0).normal(20.0, 10.0, frame.left.shape)
    result = pipeline().process(frame.left, np.clip(noise, 0, 255).astype(np.uint8))
    assert result.status is Status.TOO_FEW_SUPPORT_POINTS
    assert np.isnan(result.water.attenuation).all()


def test_one_image_for_both_sides_is_refused(frame: RenderedFrame) -> None:
    with pytest.raises(InputError, match="one and the same"):
        pipeline().process(frame.left, frame.left)


def test_disparities_that_are_but_noise_tell_no_water(frame: RenderedFrame) -> None:
    # As of a camera whose picture comes twice, compressed anew each time.
    noise = np.random.default_rng(0).integers(-1, 2, frame.left.shape)
    again = np.clip(frame.left.astype(int) + noise, 0, 255).astype(np.uint8)
    result = pipeline().process(frame.left, again)
    assert result.status is Status.RANGE_SPREAD_TOO_SMALL
    assert np.isnan(result.water.attenuation).all()


def turned(image: np.ndarray) -> np.ndarray:
    """As a pair whose cameras stand above one another, or lie on their sides, shows it."""
    return np.ascontiguousarray(image.transpose(1, 0, 2))


def test_rows_that_do_not_correspond_tell_no_water(frame: RenderedFrame) -> None:
    left, right = turned(frame.left), turned(frame.right)
    rig = StereoRig(
        CAMERA.focal_length, CAMERA.baseline,
        ((left.shape[1] - 1) / 2, (left.shape[0] - 1) / 2))
    result = Pipeline(rig).process(left, right)
    # Chance matches some of them.
    assert result.stereo.support_points >= 10
    assert result.status is Status.TOO_FEW_SUPPORT_POINTS
    assert result.coarse_water.status is Status.TOO_FEW_SUPPORT_POINTS
    assert np.isnan(result.water.attenuation).all()


def test_piles_in_open_water_are_not_matched_by_chance() -> None:
    """They look alike in all rows."""
    random = np.random.default_rng(0)
    row = np.full((700, 3), 90.0)
    for start in (150, 350, 530):
        row[start:start + 40] += random.normal(0.0, 30.0, (40, 1))
    left, right = (
        np.clip(row[start:start + 644] + random.normal(0.0, 1.0, (362, 644, 3)), 0, 255)
        for start in (0, 20))
    coarse = coarse_estimate(left.astype(np.uint8), right.astype(np.uint8))
    assert not coarse.by_chance
    assert np.median(coarse.points[:, 2]) == pytest.approx(20.0, abs=0.5)


@pytest.mark.parametrize("noise", [0.0, 2.0])
@pytest.mark.parametrize("rows", [-3, -1, 1, 3, 6])
def test_a_pair_whose_calibration_is_off_by_rows_is_refused(
    frame: RenderedFrame, rows: int, noise: float
) -> None:
    """Half of the points still match, with ranges that make distances up to twice too long."""
    random = np.random.default_rng(0)
    left, right = (
        np.clip(image + random.normal(0.0, noise, image.shape), 0, 255).astype(np.uint8)
        for image in (frame.left, np.roll(frame.right, rows, axis=0)))
    if abs(rows) == 1:
        assert coarse_estimate(left, right).coverage > 0.5
    else:
        with pytest.raises(InputError, match="rows of the left and right image do not correspond"):
            coarse_estimate(left, right)


@pytest.mark.parametrize(
    ("roll", "scale", "off"),
    [(0.2, 1.0, False), (-0.2, 1.0, False), (0.0, 1.005, False), (1.2, 1.0, True),
     (-1.2, 1.0, True), (0.0, 0.96, True), (0.0, 1.04, True)],
)
def test_a_camera_that_is_rolled_or_has_another_focal_length_is_refused(
    frame: RenderedFrame, roll: float, scale: float, off: bool
) -> None:
    """Rows of the middle correspond, those at the borders are 4 to 8 px apart."""
    height, width = frame.right.shape[:2]
    turn = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), roll, scale)
    right = cv2.warpAffine(
        frame.right, turn, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    if off:
        with pytest.raises(InputError, match="rows of the left and right image do not correspond"):
            coarse_estimate(frame.left, right)
    else:
        assert coarse_estimate(frame.left, right).coverage > 0.5


def test_a_small_thing_in_open_water_is_no_chance(frame: RenderedFrame) -> None:
    random = np.random.default_rng(0)
    left, right = (
        np.clip(np.array([40, 110, 130]) + random.normal(0, 1, frame.left.shape), 0, 255).astype(
            np.uint8) for _ in range(2))
    rows, columns, disparity = slice(220, 280), slice(300, 390), 24
    left[rows, columns] = frame.left[rows, columns]
    right[rows, columns.start - disparity:columns.stop - disparity] = frame.left[rows, columns]
    coarse = coarse_estimate(left, right)
    assert 10 <= len(coarse.points) < 400
    assert not coarse.by_chance


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_points_go_there_and_back(factor: int) -> None:
    reduction = Pyramid(factor, (300, 400))
    points = np.array([[0, 0, 3], [10, 20, 7.5], [130, 99, 0]], np.float32)
    whole = reduction.upsample_points(points)
    # The middle of a square of pixels, and its disparity.
    np.testing.assert_allclose(
        whole, points * factor + [(factor - 1) / 2, (factor - 1) / 2, 0], rtol=1e-6)
    np.testing.assert_allclose(reduction.downsample_points(whole), points, atol=1e-5)


def test_pixels_that_are_not_square_stay_so() -> None:
    rig = StereoRig(500.0, 0.1, (160.0, 120.0), None, 510.0)
    small = Pyramid(2, (240, 320)).rig(rig)
    assert small.focal_length == 250.0 and small.focal_length_y == 255.0
