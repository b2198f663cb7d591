# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Filter of the water's state over frames and its assessment, for library, node and replay.

Nothing else in the processing of a frame needs earlier frames.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import Array
from uw_visibility.status import REFUTING, Status
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.daylight.grey_average import ColourBalance, GreyFrames
from uw_visibility.water.daylight.inference import MOST_LAMPS, light_status
from uw_visibility.water.daylight.validation import refute_clearness
from uw_visibility.water.estimate import LampLight, WaterEstimate
from uw_visibility.water.lamps.survey import LampSurvey
from uw_visibility.water.meaning.assessment import Assessor, Visibility
from uw_visibility.water.series.survey import Survey, SurveyEstimate
from uw_visibility.water.series.tracking import TrackingEvent, WaterTracker

# Events of frames that do not update the state.
_UNSEEN = (TrackingEvent.PREDICTED, TrackingEvent.NOT_ASSESSABLE)
# Log odds beyond which a frame counts as certain.
CERTAIN = 3.4
# Least number of frames for a verdict on the transfer, number of recent frames averaged, and mean
# log odds beyond which the transfer is refused.
INDEPENDENT = 4
LATEST = 20
CERTAIN_TOGETHER = 1.7


class FilteredWater(NamedTuple):
    """Filtered state and its assessment up to a frame.

    Attributes
    ----------
    water : WaterEstimate
        The filtered state.
    visibility : Visibility
        Mean attenuation, visibility distance and depth of it.
    event : TrackingEvent
        Effect of the frame on the state.
    assessed, rejected : int
        Frames so far that had an estimate, and those of them that were rejected.
    rejected_in_a_row : int
        Rejected frames since the last accepted one.
    survey : SurveyEstimate or None
        Estimate from recent frames together, where `water` is that.
    """

    water: WaterEstimate
    visibility: Visibility
    event: TrackingEvent
    assessed: int = 0
    rejected: int = 0
    rejected_in_a_row: int = 0
    survey: SurveyEstimate | None = None


class KnownWater(NamedTuple):
    """Water estimated from the frames so far, with which a refused frame is restored.

    Attributes
    ----------
    water : WaterEstimate
        The filtered state, without its observations.
    stamp : float
        Time of the last frame, s.
    rig : object
        Camera that took it.
    timeout : float
        How long it is valid, s.
    """

    water: WaterEstimate
    stamp: float
    rig: object
    timeout: float

    def at(self, stamp: float, rig: object = None) -> WaterEstimate | None:
        """Return the water for the next frame; None where the filter would restart."""
        holds = rig == self.rig and 0.0 < stamp - self.stamp <= self.timeout
        return self.water if holds else None


class WaterFilter:
    """Kalman filter over the estimates of frames, taken in order, and their assessment.

    Where no recent frame is assessable alone, recent frames are estimated together.

    Parameters
    ----------
    config : PipelineConfig
        `tracking`, `survey`, and what estimate and assessment need of the camera.

    Raises
    ------
    InputError
        If the camera's spectral response cannot be loaded.

    Attributes
    ----------
    known : KnownWater or None
        Water with which the next frame is restored if it is refused; None if unknown.
    """

    def __init__(self, config: PipelineConfig) -> None:
        self.config = config
        self._assessor = Assessor(config)
        self._tracker = WaterTracker(config.tracking)
        self._by_lamps = config.lighting.model in ("lamps", "both")
        self._rig: object = None
        self.reset()

    def reset(self) -> None:
        """Reset the filter: earlier frames do not count."""
        config, clear_water = self.config, self._assessor.clear_water_attenuation
        self._tracker.reset()
        self._survey: Survey | LampSurvey
        if self._by_lamps:
            self._survey = LampSurvey(config.survey, config.lighting, clear_water)
        else:
            self._survey = Survey(
                config.survey, WaterEstimator(config.water, clear_water, self._assessor.daylight))
        self._grey = GreyFrames()
        self._transfer, self._lit = Vote(), Vote()
        self.known: KnownWater | None = None

    def update(
        self, water: WaterEstimate, stamp: float, rig: object = None
    ) -> FilteredWater | None:
        """Update the state by one frame's estimate.

        Parameters
        ----------
        water : WaterEstimate
            Of this frame alone; a survey needs its envelopes.
        stamp : float
            Time of the frame, s; one that is not later than the last restarts the filter.
        rig : object
            Camera, such as a `StereoRig`; another one restarts the filter.

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
        if rig != self._rig or stamp <= self._tracker.stamp:
            self.reset()
            self._rig = rig
        self._lit.add(water.lamps_log_odds)
        if self.config.lighting.model == "auto":
            water = self._in_this_light(water)
        self._transfer.add(water.transfer_log_odds)
        filtered = self._tracker.update(water, stamp)
        grey = self._grey.add(ColourBalance(water.grey_on_average, water.blue_as_green))
        event = self._tracker.event
        assert event is not None
        survey = self._surveyed(water, filtered, stamp, event)
        together = self._refuted(filtered)
        refuted = water.status if together is Status.OK else together
        # Frames that show nothing are bridged. What refutes a frame refutes those before it, too.
        if together is not Status.OK or (event in _UNSEEN and refuted in REFUTING):
            filtered, event, survey = WaterEstimate.not_assessable(
                refuted, water.envelope), TrackingEvent.NOT_ASSESSABLE, None
        elif survey is not None:
            filtered, event = survey.water, TrackingEvent.SURVEYED
        filtered = replace(filtered, grey_on_average=grey)
        visibility = self._assessor.assess(filtered, self._by_lamps)
        if event is TrackingEvent.PREDICTED and visibility.status is not Status.OK:
            # The reason is that of the frames that do not show the water.
            visibility = replace(visibility, status=water.status)
        if np.isfinite(filtered.attenuation).any():
            kept = replace(filtered, envelope=None, blocks=None, lamps=None)
            self.known = KnownWater(kept, stamp, rig, self.config.tracking.timeout)
        else:
            self.known = None
        return FilteredWater(
            filtered, visibility, event, self._tracker.assessed,
            self._tracker.rejected, self._tracker.rejected_in_a_row, survey)

    @property
    def lamps(self) -> LampLight | None:
        """Light of the lamps over the frames so far; None without, or by daylight."""
        return self._survey.light() if isinstance(self._survey, LampSurvey) else None

    def _surveyed(
        self, water: WaterEstimate, filtered: WaterEstimate, stamp: float, event: TrackingEvent
    ) -> SurveyEstimate | None:
        """Add a frame to the survey; return its estimate where the filter has none.

        Under lamps also where it is more precise than the filter's.
        """
        if not self.config.survey.enabled:
            return None
        self._survey.add(water, stamp)
        if not self._by_lamps and event is not TrackingEvent.NOT_ASSESSABLE:
            return None
        survey = self._survey.estimate()
        known = np.isfinite(survey.water.attenuation)
        if survey.frames < self.config.survey.min_frames or not known.any():
            return None
        # Relative to β: errors grow with it, so that too low values look precise.
        surer = _relative(survey.water) < np.nan_to_num(_relative(filtered), nan=np.inf)
        return survey if not self._by_lamps or surer[known].all() else None

    def _refuted(self, filtered: WaterEstimate) -> Status:
        """Reason why the recent frames together refute the estimate, or OK."""
        if self._transfer.frames >= INDEPENDENT and self._transfer.mean > CERTAIN_TOGETHER:
            return Status.OTHER_TRANSFER
        # A frame that looks like daylight among frames under lamps is refused.
        lamps = float(expit(self._lit.mean))
        light = light_status(1.0 - lamps if self._by_lamps else lamps, MOST_LAMPS)
        if not self._lit.frames:
            light = Status.OK
        return light if light is not Status.OK else refute_clearness(
            filtered.attenuation, filtered.covariance[0::2, 0::2],
            self._assessor.clear_water_attenuation)

    def _in_this_light(self, water: WaterEstimate) -> WaterEstimate:
        """Refuse a frame in another light than the recording's; restart where that changes."""
        by_lamps = self._lit.mean > 0.0
        if by_lamps != self._by_lamps:
            self._by_lamps, lit = by_lamps, self._lit
            self.reset()
            self._lit = lit
        if np.isfinite(water.attenuation).any() and (water.lamps is not None) != by_lamps:
            return WaterEstimate.not_assessable(Status.LIGHT_UNCERTAIN)
        return water


def _relative(water: WaterEstimate) -> Array:
    """Standard deviation of β as a part of it, (3,); NaN where not assessable."""
    return water.attenuation_stddev / water.attenuation


class Vote:
    """Mean log odds of what all frames of a recording share, such as the camera's transfer."""

    def __init__(self) -> None:
        self.mean = 0.0
        self.frames = 0

    def add(self, log_odds: float) -> None:
        """Add a frame's log odds, limited to `CERTAIN`; NaN is ignored."""
        if math.isnan(log_odds):
            return
        self.frames = min(self.frames + 1, LATEST)
        self.mean += (min(max(log_odds, -CERTAIN), CERTAIN) - self.mean) / self.frames
