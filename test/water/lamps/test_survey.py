# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A survey under lamps: frames at one altitude each, which tell together what one does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from lamp_scene import (
    CLEAR_WATER,
    LAMPS,
    RIG,
    SIZE,
    parameters,
    rays,
    render,
)

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.view import View
from uw_visibility.status import Status
from uw_visibility.water.lamps.estimation import LampEstimator, estimate_nodes
from uw_visibility.water.lamps.track_fit import TrackFit
from uw_visibility.water.series.filter import WaterFilter
from uw_visibility.water.series.tracking import TrackingEvent


def test_frames_of_one_range_each_tell_attenuation_together() -> None:
    config = PipelineConfig.from_parameters(
        parameters() | {"survey.min_frames": 10, "tracking.exposure_change": 0.0})
    reader = LampEstimator(config.water, config.lighting, CLEAR_WATER, RIG.rays_at)
    water_filter = WaterFilter(config)
    filtered = None
    exposure = 0.2
    for number, altitude in enumerate(np.linspace(1.5, 2.6, 12)):
        shown = render(
            0.2, seed=3, distance=np.full(SIZE, altitude), exposure=exposure, shift=0.7 * number,
            lamps=LAMPS)
        found = reader.estimate_view(View.of(shown.image), shown.range)
        assert found.status is Status.RANGE_SPREAD_TOO_SMALL
        filtered = water_filter.update(found, float(number))
    assert filtered is not None
    assert filtered.event is TrackingEvent.SURVEYED
    error = filtered.water.attenuation - shown.attenuation
    assert (np.abs(error) < 0.5 * shown.attenuation).all(), error
    assert (np.abs(error) < 3 * filtered.water.attenuation_stddev).all()
    light = water_filter.lamps
    assert light is not None
    np.testing.assert_array_equal(light.attenuation, filtered.water.attenuation)


def test_points_that_frames_track_make_attenuation_surer() -> None:
    config = PipelineConfig.from_parameters(parameters() | {"survey.min_frames": 10})
    reader = LampEstimator(config.water, config.lighting, CLEAR_WATER, RIG.rays_at)
    tracking, alone = WaterFilter(config), WaterFilter(config)
    with_tracks = without = None
    for number in range(11):
        altitude = 1.9 + 0.5 * np.sin(0.5 * number)
        # A floor at one depth, above which the camera moves, rises and sinks.
        distance = altitude / rays()[..., 2]
        shown = render(
            0.15, seed=4, distance=distance, exposure=1.5, lamps=LAMPS,
            shift=np.array([0.1 * number, 0.0, -altitude]))
        found = reader.estimate_view(View.of(shown.image), shown.range)
        assert found.lamps is not None
        with_tracks = tracking.update(found, float(number))
        without = alone.update(
            replace(found, lamps=replace(found.lamps, ground=None)), float(number))
    assert with_tracks is not None and without is not None
    error = with_tracks.water.attenuation / shown.attenuation - 1.0
    assert (np.abs(error) < 0.1).all(), error
    by_light = without.survey.water.attenuation_stddev if without.survey else np.inf
    assert (with_tracks.water.attenuation_stddev < 0.7 * by_light).all()


def test_tracks_that_contradict_the_nodes_do_not_count() -> None:
    config = PipelineConfig.from_parameters(parameters())
    reader = LampEstimator(config.water, config.lighting, CLEAR_WATER, RIG.rays_at)
    shown = render(0.2, seed=3, lamps=LAMPS)
    lamps = reader.estimate_view(View.of(shown.image), shown.range).lamps
    assert lamps is not None and lamps.nodes is not None
    alone = estimate_nodes([lamps.nodes], config.lighting, CLEAR_WATER)
    near = TrackFit(np.log(1.05 * alone.attenuation), 0.05**2 * np.eye(3))
    joined = estimate_nodes([lamps.nodes], config.lighting, CLEAR_WATER, tracks=near)
    assert (joined.attenuation > 1.01 * alone.attenuation).all()
    assert (joined.attenuation_stddev < alone.attenuation_stddev).all()
    # As bright through more water: the lamps are stronger, and the ground is restored as bright.
    assert joined.lamps is not None
    assert (joined.lamps.power > lamps.power).all()
    far = replace(near, log_attenuation=np.log(4.0 * alone.attenuation))
    refuted = estimate_nodes([lamps.nodes], config.lighting, CLEAR_WATER, tracks=far)
    np.testing.assert_array_equal(refuted.attenuation, alone.attenuation)
    # Red alone is off, as over flat ground from one altitude, by what chance makes in 2 of 100.
    covariance = 1e-2 * np.diag((alone.attenuation_stddev / alone.attenuation) ** 2)
    relative = alone.covariance[0::2, 0::2] / np.outer(alone.attenuation, alone.attenuation)
    weight = np.linalg.inv(relative + covariance)
    red = np.log(alone.attenuation) - [np.sqrt(10.0 / weight[0, 0]), 0.0, 0.0]
    loose = replace(near, log_attenuation=red, covariance=covariance)
    chance = estimate_nodes([lamps.nodes], config.lighting, CLEAR_WATER, tracks=loose)
    np.testing.assert_array_equal(chance.attenuation, alone.attenuation)
