# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The truth that comes with a rendered frame is true, and the same every time."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes import flat_floor

from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError
from uw_visibility_lab.simulation.camera import NOISELESS, Pose, StereoCamera
from uw_visibility_lab.simulation.frame import Effects, RenderedFrame, Renderer
from uw_visibility_lab.simulation.scene import Scene, reef
from uw_visibility_lab.simulation.water import Water

CAMERA = StereoCamera(160, 120, 150.0, 0.12)
RIG = CAMERA.rig
POSE = Pose((0.0, 0.0, 1.5), heading=0.05, tilt=0.28, roll=0.03)
WATER = Water(mean_attenuation=0.1, depth=3.0)
RENDERER = Renderer(CAMERA, NOISELESS)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return reef(5, 2.0, 20.0)


@pytest.fixture(scope="module")
def frame(scene: Scene) -> RenderedFrame:
    return RENDERER.render(scene, POSE, WATER)


def test_range_and_disparity_agree_with_the_rig(frame: RenderedFrame) -> None:
    seen = np.isfinite(frame.range_left)
    assert 0.3 < seen.mean() < 0.99
    assert np.isposinf(frame.range_left[~seen]).all()
    np.testing.assert_array_equal(np.isfinite(frame.disparity_left), seen)
    for disparity, ranges in (
        (frame.disparity_left, frame.range_left), (frame.disparity_right, frame.range_right)
    ):
        known = np.isfinite(disparity)
        derived = RIG.range_from_disparity(disparity)
        np.testing.assert_allclose(derived[known], ranges[known], rtol=1e-5)


def test_warping_right_by_the_disparity_gives_left(frame: RenderedFrame) -> None:
    columns, rows = np.meshgrid(
        np.arange(160, dtype=np.float32), np.arange(120, dtype=np.float32)
    )
    disparity = np.nan_to_num(frame.disparity_left, nan=0.0)
    partner = columns - disparity

    def warp(image: np.ndarray) -> np.ndarray:
        return cv2.remap(image, partner, rows, cv2.INTER_LINEAR, borderValue=(np.nan,) * 3)

    back = warp(np.nan_to_num(frame.disparity_right, nan=0.0))
    # Seen by both, and no edge nearby where interpolation mixes two surfaces.
    visible = np.isfinite(frame.disparity_left) & (np.abs(back - disparity) < 0.05)
    error = np.abs(warp(frame.radiance_right) - frame.radiance_left).max(axis=2)
    shifted = np.abs(np.roll(frame.radiance_left, 2, axis=1) - frame.radiance_left).max(axis=2)
    assert visible.mean() > 0.5
    # What is left is the bilinear interpolation of a fine texture.
    assert np.median(error[visible]) < 0.015
    assert np.median(error[visible]) < 0.15 * np.median(shifted[visible])


def test_some_pixels_are_seen_by_one_camera_only(frame: RenderedFrame) -> None:
    rows, columns = np.nonzero(np.isfinite(frame.disparity_left))
    disparity = frame.disparity_left[rows, columns]
    partner = np.rint(columns - disparity).astype(int)
    inside = partner >= 0
    other = frame.disparity_right[rows[inside], partner[inside]]
    # An occluder is nearer than what it hides.
    occluded = other > disparity[inside] + 1.0
    assert 0.002 < occluded.mean() < 0.2


def test_inverse_of_the_light_model_gives_the_radiance_back() -> None:
    # Without edges: a pixel that mixes two surfaces has no one radiance.
    slanted = Pose((0.0, 0.0, 1.5), tilt=0.9)
    frame = RENDERER.render(flat_floor(), slanted, WATER)
    assert np.ptp(frame.range_left) > 1.0
    gain = np.exp(frame.attenuation * frame.range_left[..., np.newaxis])
    radiance = 1.0 + (frame.left / 255.0 / frame.ambient_light - 1.0) * gain
    # Half a grey level, amplified.
    quantum = 0.5 / 255.0 / frame.ambient_light * gain
    assert (np.abs(radiance - frame.radiance_left) <= quantum + 1e-5).all()


def test_open_water_is_ambient_light(frame: RenderedFrame) -> None:
    open_water = np.isinf(frame.range_left)
    open_water[1:] &= open_water[:-1].copy()
    open_water &= np.roll(open_water, -1, axis=0)
    expected = np.rint(255.0 * frame.ambient_light)
    # The row above the horizon may mix in what is below.
    assert np.mean((frame.left[open_water] == expected).all(axis=1)) > 0.97


def test_truth_of_the_water(frame: RenderedFrame) -> None:
    clear = frame.attenuation - 0.1
    np.testing.assert_allclose(clear, [0.228, 0.066, 0.025], atol=0.002)
    assert (frame.mean_attenuation, frame.depth) == (0.1, 3.0)
    decay = np.exp(-frame.attenuation * 3.0)
    np.testing.assert_allclose(frame.ambient_light, 0.8 * decay / decay.max())
    fixed = replace(WATER, exposure=2.0)
    np.testing.assert_allclose(fixed.ambient_light(), 2.0 * decay)


def test_radiance_spans_dark_and_bright_at_every_range(scene: Scene) -> None:
    frame = Renderer(StereoCamera(), NOISELESS).render(scene, POSE, WATER)
    for low, high in ((2.0, 3.0), (3.0, 5.0), (5.0, 10.0)):
        near = (frame.range_left > low) & (frame.range_left <= high)
        dark, bright = np.percentile(frame.radiance_left[near], [1, 99])
        assert dark < 0.05
        assert bright > 0.6
    assert frame.radiance_left.min() >= 0.0
    assert frame.radiance_left.max() <= 1.0


def test_same_bits_every_time_and_for_any_number_of_threads(scene: Scene) -> None:
    noisy = Renderer(CAMERA, effects=Effects(0.01, 0.2), workers=Workers(1))
    first = noisy.render(scene, POSE, WATER, seed=3, time=1.5)
    again = replace(noisy, workers=Workers(3)).render(
        reef(5, 2.0, 20.0), POSE, WATER, seed=3, time=1.5
    )
    for name in ("left", "right", "range_left", "disparity_right", "radiance_left"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    other = noisy.render(scene, POSE, WATER, seed=4, time=1.5)
    assert (other.left != first.left).mean() > 0.3


def test_a_flat_floor_from_above_has_one_depth() -> None:
    above = Pose((0.0, 0.0, 1.2), tilt=math.pi / 2)
    frame = RENDERER.render(flat_floor(), above, WATER)
    np.testing.assert_allclose(frame.disparity_left, 150.0 * 0.12 / 1.2, rtol=1e-4)
    assert frame.left.std() > 5.0


def test_a_floor_without_texture_is_one_colour() -> None:
    above = Pose((0.0, 0.0, 1.2), tilt=math.pi / 2)
    frame = RENDERER.render(flat_floor(texture=0.0), above, WATER)
    assert len(np.unique(frame.radiance_left.reshape(-1, 3), axis=0)) == 1


def test_marine_snow_covers_its_share(frame: RenderedFrame, scene: Scene) -> None:
    snowy = replace(RENDERER, effects=Effects(marine_snow=0.02)).render(scene, POSE, WATER)
    changed = (np.abs(snowy.left.astype(int) - frame.left) > 2).any(axis=2)
    below = np.isfinite(frame.range_left)
    assert 0.01 < changed[below].mean() < 0.05
    np.testing.assert_array_equal(snowy.range_left, frame.range_left)


def test_caustics_change_light_within_their_bounds(frame: RenderedFrame, scene: Scene) -> None:
    lit = replace(RENDERER, effects=Effects(caustics=0.2)).render(scene, POSE, WATER)
    ratio = lit.radiance_left / np.maximum(frame.radiance_left, 1e-6)
    seen = np.isfinite(frame.range_left) & (frame.radiance_left.min(axis=2) > 0.01)
    assert ratio[seen].min() >= 0.8 - 1e-5
    assert ratio[seen].max() <= 1.2 + 1e-5
    assert ratio[seen].std() > 0.05


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: Water(-0.1, 2.0), "mean attenuation"),
        (lambda: Water(0.1, -2.0), "depth"),
        (lambda: Water(0.1, math.inf), "depth"),
        (lambda: Water(0.1, 2.0, 0.0), "exposure"),
        (lambda: Effects(marine_snow=0.9), "marine snow"),
        (lambda: Effects(caustics=-0.1), "caustics"),
    ],
)
def test_what_is_no_water_is_refused(make, what: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=what):
        make()
