# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Calibration of lamps from the light of points that frames track."""

from __future__ import annotations

from dataclasses import fields

import pytest
from lamp_floor import LIGHTING, sightings

from uw_visibility.errors import InputError
from uw_visibility.water.lamps.calibration import calibrate_lamps
from uw_visibility.water.lamps.tracks import Sightings


def test_lamps_are_not_calibrated_by_points_that_the_water_outshines() -> None:
    # A third of the points is nearly black: what is seen in front of them is the water alone.
    frames = [
        Sightings(*(getattr(seen, field.name)[seen.track % 4 == 0] for field in fields(Sightings)))
        for seen in sightings(frames=16, outshone=0.3)]
    with pytest.raises(InputError, match="outshines them"):
        calibrate_lamps(frames, [list(LIGHTING.lamps())])
