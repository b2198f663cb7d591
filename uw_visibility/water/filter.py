# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Filter of the water's state over frames and its assessment, for library, node and replay.

The only part of a frame's way that needs the frames before it.
"""

from __future__ import annotations

from typing import NamedTuple

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.water.assessment import Assessor, Visibility
from uw_visibility.water.estimation import WaterEstimate
from uw_visibility.water.tracking import TrackingEvent, WaterTracker


class FilteredWater(NamedTuple):
    """Filtered state and its assessment up to a frame.

    Attributes
    ----------
    water : WaterEstimate
        The filtered state.
    visibility : Visibility
        Mean attenuation, visibility distance and depth of it.
    event : TrackingEvent
        What the frame did to the state.
    """

    water: WaterEstimate
    visibility: Visibility
    event: TrackingEvent


class WaterFilter:
    """Kalman filter over the estimates of frames, taken in order, and their assessment.

    Parameters
    ----------
    config : PipelineConfig
        `tracking`, and what the assessment needs of the camera.

    Raises
    ------
    InputError
        If the camera's spectral response cannot be loaded.
    """

    def __init__(self, config: PipelineConfig) -> None:
        self.config = config
        self._assessor = Assessor.from_config(config)
        self._tracker = WaterTracker(config.tracking)
        self._rig: object = None

    def update(
        self, water: WaterEstimate, stamp: float, rig: object = None
    ) -> FilteredWater | None:
        """Take in one frame's estimate.

        Parameters
        ----------
        water : WaterEstimate
            Of this frame alone.
        stamp : float
            Time of the frame, s; one that is not later than the last begins anew.
        rig : object
            What took the frame, such as a `StereoRig`; another one begins anew.

        Returns
        -------
        FilteredWater or None
            None where `tracking.enabled` is off.

        Raises
        ------
        InputError
            If the stamp is not finite.
        """
        if not self.config.tracking.enabled:
            return None
        if rig != self._rig:
            self.reset()
            self._rig = rig
        filtered = self._tracker.update(water, stamp)
        event = self._tracker.event
        assert event is not None
        return FilteredWater(filtered, self._assessor.assess(filtered), event)

    def reset(self) -> None:
        """Reset the filter: earlier frames do not count."""
        self._tracker.reset()
