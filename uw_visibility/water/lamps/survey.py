# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water and light under lamps over many frames.

Above flat ground one frame's ranges are too alike to show how light falls; a vehicle that
climbs, sinks and pitches shows it over a minute. Power and exposure are taken to stay the
same, so that nodes of different frames compare like those of one.
"""

from __future__ import annotations

import math

import numpy as np

from uw_visibility.config.lighting import LightingConfig
from uw_visibility.config.schema import SurveyConfig
from uw_visibility.images.arrays import Array
from uw_visibility.status import Status
from uw_visibility.water.estimate import LampLight, WaterEstimate
from uw_visibility.water.lamps.estimation import estimate_nodes
from uw_visibility.water.lamps.nodes import MOST_NODES, Nodes
from uw_visibility.water.lamps.track_fit import fit_tracks
from uw_visibility.water.lamps.tracks import WIDE, PointTracker, Sightings
from uw_visibility.water.series.survey import BLOCKS, INTERVAL, FrameWindow, SurveyEstimate


class LampSurvey:
    """Estimator of the water from the nodes of all frames in a time window."""

    def __init__(
        self, config: SurveyConfig, lighting: LightingConfig, clear_water_attenuation: Array
    ) -> None:
        self._config = config
        self._lighting = lighting
        self._clear_water = clear_water_attenuation
        self._frames: FrameWindow[Nodes] = FrameWindow(self._config)
        self._tracker = PointTracker(apart=WIDE)
        self._sightings: FrameWindow[Sightings] = FrameWindow(self._config)
        self._range_error = 0.0
        self._last: tuple[float, SurveyEstimate] | None = None

    def add(self, water: WaterEstimate, stamp_seconds: float) -> None:
        """Add a frame's nodes, if any; its stamp (s) is later than those before."""
        light = water.lamps
        self._frames.add(None if light is None else light.nodes, stamp_seconds)
        seen = None
        if light is not None and light.ground is not None:
            seen, self._range_error = light.ground.observe(self._tracker), light.ground.range_error
        self._sightings.add(seen, stamp_seconds)

    def estimate(self) -> SurveyEstimate:
        """Estimate the water over the frames of the window, once in `INTERVAL`."""
        newest = self._frames.newest
        # While there are few frames, each one adds much.
        few = len(self._frames) <= BLOCKS
        if self._last is None or few or not newest - self._last[0] < INTERVAL:
            self._last = newest, self._fresh()
        return self._last[1]

    def light(self) -> LampLight | None:
        """Light estimated over the window; None where not assessable."""
        light = self.estimate().water.lamps
        return light if light is not None and np.isfinite(light.attenuation).any() else None

    def _fresh(self) -> SurveyEstimate:
        frames, lighting = self._frames.items, self._lighting
        water = WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
        if frames:
            tracks = None
            if lighting.model != "both":
                tracks = fit_tracks(self._sightings.items, lighting, self._range_error)
            water = estimate_nodes(_thinned(frames), lighting, self._clear_water, tracks=tracks)
        return SurveyEstimate.of(water, self._frames, [nodes.range for nodes in frames])


def _thinned(frames: list[Nodes]) -> list[Nodes]:
    """Frames, evenly spaced, and their nodes, in the same proportion, to `MOST_NODES` in all."""
    excess = math.sqrt(sum(len(nodes.range) for nodes in frames) / MOST_NODES)
    every = max(1, round(excess))
    step = max(1, round(math.sqrt(excess)))
    return [nodes.every(step) for nodes in frames[::-1][::every][::-1]]
