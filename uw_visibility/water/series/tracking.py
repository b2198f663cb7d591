# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Filter of the water's state over frames: gate, runs of rejected frames, events."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import StrEnum

import numpy as np

from uw_visibility.config.schema import TrackingConfig
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate, blank, of_channels
from uw_visibility.water.series.kalman import ATTENUATION, LIGHT, Measurement, WaterState


class TrackingEvent(StrEnum):
    """Event of the filter: the effect of a frame on the state."""

    STARTED = "started"
    UPDATED = "updated"
    OUTLIER = "outlier"
    RESTARTED = "restarted"
    PREDICTED = "predicted"
    NOT_ASSESSABLE = "not assessable"
    SURVEYED = "survey"


_TAKEN_IN = (TrackingEvent.STARTED, TrackingEvent.UPDATED, TrackingEvent.RESTARTED)


class WaterTracker:
    """Filter of estimates of the water's state over time.

    Attributes
    ----------
    event : TrackingEvent or None
        Effect of the last frame; None before the first.
    estimate : WaterEstimate or None
        The filtered state after the last frame; None before the first.
    assessed, rejected : int
        Frames with an estimate, and those of them that the gate rejected; a reset keeps both.
    rejected_in_a_row : int
        Frames beyond the gate since the last accepted one.
    """

    def __init__(self, config: TrackingConfig | None = None) -> None:
        self._config = config or TrackingConfig()
        self.assessed = self.rejected = 0
        self.reset()

    def reset(self) -> None:
        """Reset the state; the counts of frames are kept."""
        self.event: TrackingEvent | None = None
        self.estimate: WaterEstimate | None = None
        self.rejected_in_a_row = 0
        self._state: WaterState | None = None
        # The last measurement, if it was rejected.
        self._outlier: Measurement | None = None
        # Covariance by the chance that rejected frames are right.
        self._doubt = np.zeros((6, 6))
        # Scene light over the veil in the accepted frames, and covariance of its logarithm.
        self._light = np.full(3, np.nan)
        self._light_covariance: Array | None = None
        # Of the last frame, s.
        self.stamp = -math.inf

    def update(self, estimate: WaterEstimate, stamp_seconds: float) -> WaterEstimate:
        """Return the state, updated by the estimate of one frame alone.

        A channel that is not assessable is predicted; one not seen for longer than the timeout
        becomes not assessable, for the frame's reason. A stamp, s, that is not later than the last
        one, or later by more than the timeout, restarts the filter. `envelope`, `bins` and
        `iterations` are the frame's. Raises `InputError` if the stamp is not finite.
        """
        if not math.isfinite(stamp_seconds):
            raise InputError(f"the stamp of the frame is {stamp_seconds}: give a time in seconds")
        elapsed = stamp_seconds - self.stamp
        if not 0.0 < elapsed <= self._config.timeout:
            self.reset()
        self.stamp = stamp_seconds
        measurement = Measurement.of(estimate, self._config.common_error)
        if self._state is not None:
            self._state.predict(elapsed, self._config, bool(measurement.seen.any()))
            if not self._state.known.any():
                self._state = None
                self._settle()
        self.event = self._correct(measurement)
        if estimate.light_covariance is not None and self.event in _TAKEN_IN:
            light = estimate.scene_light / estimate.ambient_light
            self._light = np.where(np.isfinite(light), light, self._light)
            self._light_covariance = _renewed(self._light_covariance, estimate.light_covariance)
        self.estimate = self._filtered(estimate)
        return self.estimate

    def _settle(self) -> None:
        self.rejected_in_a_row = 0
        self._outlier = None
        self._doubt = np.zeros((6, 6))

    def _correct(self, measurement: Measurement) -> TrackingEvent:
        if not measurement.seen.any():
            return TrackingEvent.NOT_ASSESSABLE if self._state is None else TrackingEvent.PREDICTED
        self.assessed += 1
        if self._state is None:
            self._state = WaterState(measurement)
            return TrackingEvent.STARTED
        event = TrackingEvent.UPDATED
        if not self._state.accepts(measurement, self._config.gate_probability):
            self.rejected_in_a_row += 1
            before, self._outlier = self._outlier, measurement
            agree = before is not None and before.agrees(measurement, self._config)
            if self.rejected_in_a_row < self._config.reset_count and not agree:
                self.rejected += 1
                share = self.rejected_in_a_row / (self._config.reset_count + 1)
                self._doubt = self._state.reject(measurement, share)
                return TrackingEvent.OUTLIER
            event = TrackingEvent.RESTARTED
        self._state.adapt(measurement, self._config)
        self._state.correct(measurement)
        self._settle()
        return event

    def _filtered(self, estimate: WaterEstimate) -> WaterEstimate:
        if self._state is None:
            return estimate
        known = self._state.known
        status = [Status.OK if known[c] else estimate.channel_status[c] for c in range(3)]
        mean, joint = self._state.published(self._doubt)
        mean[np.repeat(~known, 2)] = np.nan
        light = None
        if self._light_covariance is not None:
            light = self._light * mean[LIGHT]
            if estimate.light is not None and self.event in _TAKEN_IN:
                # The frame's own: the ratio to its veil would add the error of that.
                light = np.where(known & np.isfinite(estimate.light), estimate.light, light)
        return replace(
            estimate, light=light, light_covariance=self._light_covariance, clearest=None,
            **of_channels(status, mean[ATTENUATION], mean[LIGHT], blank(joint, known)))


def _renewed(before: Array | None, new: Array) -> Array:
    """Covariance updated in the channels that a frame shows; the others keep theirs."""
    if before is None:
        return new
    shown = np.isfinite(np.diag(new))
    kept = np.where(np.outer(~shown, ~shown), before, 0.0)
    return np.asarray(np.where(np.outer(shown, shown), new, kept))
