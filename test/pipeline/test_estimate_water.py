# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Attenuation and visibility from one image and disparities of one's own."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility import StereoRig, estimate_water
from uw_visibility.errors import InputError
from uw_visibility.status import Status
from uw_visibility_lab.evaluation.scenes import load_source


@pytest.fixture(scope="module")
def rendered():
    """Return a rendered reef, seen through turbid water, and its rig."""
    scene = load_source(0)
    rig = scene.rig
    clear = np.array([0.228, 0.066, 0.025])
    left, _ = scene.degraded(0.2, 2.0, clear)
    return left, scene.disparity_left, rig, clear + 0.2


def test_recovers_attenuation_from_disparities(rendered):
    left, disparity, rig, truth = rendered
    result = estimate_water(left, disparity, rig)
    assert result.status is Status.OK
    assert set(result.reasons) <= {"water type"}
    error = np.abs(result.water.attenuation - truth)
    assert (error < 3 * result.water.attenuation_stddev).all()
    assert result.visibility.distance == pytest.approx(2.351 / truth.min(), rel=0.25)


def test_ranges_do_not_depend_on_the_baseline_that_stands_for_them(rendered):
    left, disparity, rig, _ = rendered
    wide = StereoRig(rig.focal_length, 10 * rig.baseline, rig.principal_point)
    one = estimate_water(left, disparity, rig, disparity_stddev=0.3)
    other = estimate_water(left, 10 * disparity, wide, disparity_stddev=3.0)
    np.testing.assert_allclose(other.water.attenuation, one.water.attenuation, rtol=1e-4)


def test_says_why_without_ranges(rendered):
    left, disparity, rig, _ = rendered
    result = estimate_water(left, np.full_like(disparity, np.nan), rig)
    assert result.status is Status.TOO_FEW_OBSERVATIONS
    assert result.reasons["visibility"] == str(Status.TOO_FEW_OBSERVATIONS)
    assert np.isnan(result.visibility.distance)


def test_names_what_does_not_fit(rendered):
    left, disparity, rig, _ = rendered
    with pytest.raises(InputError, match="one floating-point number per pixel"):
        estimate_water(left, disparity[:-1], rig)
    with pytest.raises(InputError, match=r"give \(height, width, 3\) RGB or"):
        estimate_water(left[..., :2], disparity, rig)
    with pytest.raises(InputError, match="int32"):
        estimate_water(left.astype(np.int32), disparity, rig)
    with pytest.raises(InputError, match="valid pixels are bool of shape"):
        estimate_water(left, disparity, rig, valid=np.ones((4, 4), bool))
    with pytest.raises(InputError, match="disparity_stddev"):
        estimate_water(left, disparity, rig, disparity_stddev=-1.0)
    for other in (None, "1", np.nan, disparity):
        with pytest.raises(InputError, match="disparity_stddev"):
            estimate_water(left, disparity, rig, disparity_stddev=other)


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (3, 700), (63, 700), (700, 95)])
def test_names_an_image_that_is_too_small(shape):
    disparity = np.linspace(5.0, 60.0, shape[0] * shape[1], dtype=np.float32).reshape(shape)
    rig = StereoRig(600.0, 0.12, (47.5, 31.5))
    with pytest.raises(InputError, match=f"{shape[1]}x{shape[0]} px: give at least 96x64 px"):
        estimate_water(np.full((*shape, 3), 77, np.uint8), disparity, rig)
