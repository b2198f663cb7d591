# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water and light under lamps over many frames.

Above flat ground one frame's ranges are too alike to show how light falls; a vehicle that
climbs, sinks and pitches shows it over a minute. Power and exposure are taken to stay the
same, so that cells of different frames compare as those of one do. The covariance holds
the spread over blocks of frames that are left out in turn (delete-a-group jackknife: Künsch
1989, doi:10.1214/aos/1176347265), since frames that follow one another show the same ground.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from uw_visibility.config.schema import SurveyConfig
from uw_visibility.images.arrays import Array
from uw_visibility.status import Status
from uw_visibility.water.estimate import LampLight, WaterEstimate
from uw_visibility.water.lamps.cells import Cells
from uw_visibility.water.lamps.estimation import CellEstimator
from uw_visibility.water.lamps.track_fit import TrackFit
from uw_visibility.water.lamps.tracks import WIDE, PointTracker, Sightings
from uw_visibility.water.series.survey import (
    BLOCKS,
    INTERVAL,
    FrameWindow,
    SurveyEstimate,
    wider,
    without_blocks,
)

# Cells that are fitted together at most; of more, evenly spaced ones.
MOST_CELLS = 3000


class LampSurvey:
    """Takes the cells of frames together over a window of time."""

    def __init__(self, config: SurveyConfig, estimator: CellEstimator) -> None:
        self._estimator = estimator
        self._frames: FrameWindow[Cells] = FrameWindow(config)
        self._tracker = PointTracker(apart=WIDE)
        self._sightings: FrameWindow[Sightings] = FrameWindow(config)
        self._last: tuple[float, SurveyEstimate] | None = None

    def reset(self) -> None:
        """Forget all frames."""
        self._frames.clear()
        self._tracker = PointTracker(apart=WIDE)
        self._sightings.clear()
        self._last = None

    def add(self, water: WaterEstimate, stamp_seconds: float) -> None:
        """Add a frame's cells, if any; a stamp (s) not later than the last one begins anew."""
        if not self._frames.continued_by(stamp_seconds):
            self.reset()
        light = water.lamps
        self._frames.add(None if light is None else light.cells, stamp_seconds)
        self._sightings.add(
            None if light is None or light.ground is None else light.ground.observe(self._tracker),
            stamp_seconds)

    def estimate(self) -> SurveyEstimate:
        """Estimate the water over the frames of the window, once in `INTERVAL`."""
        newest = self._frames.newest
        # While there are few frames, each of them tells much.
        few = len(self._frames) <= BLOCKS
        if self._last is None or few or not newest - self._last[0] < INTERVAL:
            self._last = newest, self._fresh()
        return self._last[1]

    def light(self) -> LampLight | None:
        """Light over the frames of the window; None where none shows it."""
        light = self.estimate().water.lamps
        return light if light is not None and np.isfinite(light.attenuation).any() else None

    def _fresh(self) -> SurveyEstimate:
        frames = self._frames.items
        water = WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
        if frames:
            tracks = self._estimator.fit_tracks(self._sightings.items)
            water = self._estimator.estimate_cells(_pool(frames), tracks=tracks)
            if len(frames) >= 2 * BLOCKS and np.isfinite(water.attenuation).any():
                water = self._with_spread(water, frames, tracks)
        return SurveyEstimate.of(water, self._frames, [cells.range for cells in frames])

    def _with_spread(
        self, water: WaterEstimate, frames: list[Cells], tracks: TrackFit | None
    ) -> WaterEstimate:
        """Add the jackknife's covariance of attenuation."""
        parts = np.array([
            self._estimator.estimate_cells(_pool(subset), tracks=tracks).attenuation
            for subset in without_blocks(frames)])
        away = np.nan_to_num(parts - water.attenuation)
        return wider(water, (BLOCKS - 1) / BLOCKS * away.T @ away)


def _pool(frames: list[Cells]) -> Cells:
    """Cells of all frames."""
    total = sum(len(cells.range) for cells in frames)
    step = -(-total // MOST_CELLS)

    def joined(name: str) -> Array:
        parts = [getattr(cells, name) for cells in frames]
        return np.asarray(np.concatenate(parts, axis=-1)[..., ::step])

    values = {field.name: joined(field.name) for field in fields(Cells) if field.name != "log_far"}
    return Cells(**values, log_far=frames[-1].log_far)
