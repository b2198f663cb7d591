# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The field's quantities from attenuation: closed forms, and water types from rendered spectra."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility import estimate_water
from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.optics.water_type import TYPES, water_type, water_types
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.derived import QUANTITIES, DerivedModel
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.formation import form_image
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.view import look
from uw_visibility_lab.simulation.water import Water, WaterEffects

MODEL = DerivedModel(PipelineConfig())
CLEAR = np.array([0.228, 0.066, 0.025])


def estimate(attenuation, relative_stddev=0.05):
    attenuation = np.asarray(attenuation, float)
    covariance = np.zeros((6, 6))
    covariance[0::2, 0::2] = np.diag((relative_stddev * attenuation) ** 2)
    return WaterEstimate(
        Status.OK, attenuation, np.full(3, 0.5), covariance, 1, 20, (Status.OK,) * 3)


def test_black_disc_and_its_standard_deviation():
    found = MODEL.derive(estimate([0.6, 0.4, 0.38], 0.1))
    assert found.beam_attenuation == 0.4
    assert found.beam_attenuation_stddev == pytest.approx(0.04)
    # A transmissometer reads twice what a camera sees, within a factor of 1.35.
    assert found.black_disc_visibility == pytest.approx(6.0)
    # A tenth from the attenuation, and a tenth that the formula itself is off by.
    relative = np.sqrt(0.01 + 0.01 + 0.09)
    assert found.black_disc_visibility_stddev == pytest.approx(6.0 * relative)
    assert found.black_disc_visibility_low == pytest.approx(6.0 / np.exp(relative))
    assert found.black_disc_visibility_high == pytest.approx(6.0 * np.exp(relative))


def test_turbid_water_hides_a_disk_sooner():
    found = [MODEL.derive(estimate(CLEAR + more)) for more in (0.0, 0.03, 0.3, 1.0)]
    assert [each.water_type_status for each in found] == [Status.OK] * 4
    depths = [each.secchi_depth for each in found]
    assert depths == sorted(depths, reverse=True)
    diffuse = [each.diffuse_attenuation_490 for each in found]
    assert diffuse == sorted(diffuse)
    order = [TYPES.index(each.water_type) for each in found]
    assert order == sorted(order)
    for each in found:
        # Within a standard deviation of the type that is named.
        named = water_type(each.water_type)
        assert abs(each.secchi_depth - named.secchi_depth) < each.secchi_depth_stddev
        assert 0.2 * each.secchi_depth < each.secchi_depth_stddev < 0.6 * each.secchi_depth


def test_types_are_compared_as_a_camera_sees_them():
    """A path-traced reef in water of type II: a 0.073, b 0.190 1/m in green, β 0.117."""
    found = MODEL.derive(estimate([0.223, 0.117, 0.093], 0.15))
    assert found.water_type == "II"
    # Divers see a black disc and a Secchi disk about equally far.
    assert 0.6 < found.secchi_depth / found.black_disc_visibility < 1.4


def test_what_cannot_be_told_is_refused():
    unsure = MODEL.derive(estimate([0.6, 0.4, 0.38], 1.5))
    assert unsure.water_type_status is Status.WATER_TYPE_UNCERTAIN
    assert unsure.water_type == ""
    assert np.isnan(unsure.secchi_depth)
    assert np.isnan(unsure.black_disc_visibility)
    # Blue far beyond green, as in no sea.
    odd = MODEL.derive(estimate([0.3, 0.3, 3.0]))
    assert odd.water_type_status is Status.NO_WATER_TYPE
    assert odd.black_disc_visibility == pytest.approx(8.0)
    nothing = MODEL.derive(WaterEstimate.not_assessable(Status.TOO_DARK))
    assert nothing.water_type_status is Status.TOO_DARK
    assert all(np.isnan(getattr(nothing, name)) for name in QUANTITIES)


def test_a_dark_channel_does_not_hinder():
    found = estimate([0.6, 0.403, 0.448])
    found.attenuation[0] = np.nan
    found.covariance[:2] = found.covariance[:, :2] = np.nan
    assert MODEL.derive(found).water_type == "5C"


@pytest.mark.long
def test_types_are_found_in_images_rendered_with_their_spectra():
    """Right or a neighbour in nine of ten, where the standard deviation says it can be told."""
    right, told = 0, 0
    camera = StereoCamera(480, 360, 450.0, 0.12)
    pose = Pose((0.0, 0.0, 1.6), tilt=np.radians(30.0))
    seen = look(reef(0, length=0.0), camera, pose, Workers(1))
    disparity = camera.rig.disparity_from_range(
        np.where(np.isfinite(seen.range), seen.range, np.nan))
    for name in water_types():
        for depth in (2.0, 8.0):
            water = Water(0.0, depth, None, WaterEffects(water_type=name))
            image = np.round(255 * form_image(seen, water))
            found = estimate_water(
                image.clip(0, 255).astype(np.uint8), disparity, camera.rig,
                disparity_stddev=0.0).derived
            if found.water_type_status is Status.OK:
                told += 1
                distance = TYPES.index(found.water_type) - TYPES.index(name)
                right += abs(distance) <= 1
    assert told >= 6
    assert right >= 0.9 * told
