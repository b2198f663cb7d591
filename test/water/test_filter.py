# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The filter over frames: begun anew with another rig, and off where it is turned off."""

from __future__ import annotations

import numpy as np

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.status import Status
from uw_visibility.water.estimation import WaterEstimate
from uw_visibility.water.filter import WaterFilter
from uw_visibility.water.tracking import TrackingEvent

STARTED, UPDATED = TrackingEvent.STARTED, TrackingEvent.UPDATED


def water() -> WaterEstimate:
    covariance = np.array([np.diag([0.02**2, 0.01**2])] * 3)
    return WaterEstimate(
        Status.OK, np.array([0.5, 0.3, 0.2]), np.array([0.1, 0.4, 0.6]), covariance, 9, 30,
        (Status.OK,) * 3,
    )


def test_another_rig_begins_anew_and_the_same_one_does_not() -> None:
    kept = WaterFilter(PipelineConfig())
    events = []
    for number, rig in enumerate(("a", "a", "b", "b", "a")):
        found = kept.update(water(), float(number), rig)
        assert found is not None
        events.append(found.event)
    assert events == [STARTED, UPDATED, STARTED, UPDATED, STARTED]


def test_a_filter_that_is_reset_begins_anew() -> None:
    kept = WaterFilter(PipelineConfig())
    kept.update(water(), 0.0)
    kept.reset()
    found = kept.update(water(), 1.0)
    assert found is not None and found.event is STARTED


def test_what_is_filtered_is_assessed_too() -> None:
    kept = WaterFilter(PipelineConfig())
    first, second = (kept.update(water(), time) for time in (0.0, 1.0))
    assert first is not None and second is not None
    assert second.visibility.distance > 0
    assert second.visibility.distance_stddev < first.visibility.distance_stddev


def test_nothing_is_filtered_where_tracking_is_off() -> None:
    off = WaterFilter(PipelineConfig.from_parameters({"tracking.enabled": False}))
    assert off.update(water(), 0.0) is None
