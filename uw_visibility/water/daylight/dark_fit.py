# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit of the dark envelope with one ambient light for veil and scene."""

from __future__ import annotations

import numpy as np

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.water.daylight.fit import Fit, fit_plain
from uw_visibility.water.daylight.lower_envelope import fit_lower_envelope
from uw_visibility.water.daylight.validation import (
    black_attenuation,
    brightest_patch,
    least_ambient_light,
)
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.observations import Envelopes


def fit_one_light(
    envelope: Envelopes, active: Mask, start: WaterEstimate | None, range_error: float,
    clear_water: Array, plain: bool,
) -> Fit:
    """Fit the dark envelope with one ambient light for veil and scene (eq. 6-7).

    `start` is an earlier estimate; `plain` fits as the paper does.
    """
    ambient_min = np.array([
        least_ambient_light(envelope, c) if active[c] else 1.0 for c in range(3)])
    first = np.stack((clear_water, ambient_min), axis=1)
    for c in np.flatnonzero(active):
        if plain:
            first[c, 1] = np.nanmax(envelope.bright[c])
        else:
            # From above: what is brighter than the curve of the water holds it less.
            first[c, 0] = np.median(black_attenuation(envelope, int(c), ambient_min[c]))
    if start is not None:
        known = np.isfinite(start.attenuation)
        first[known, 0] = start.attenuation[known]
        first[known, 1] = start.ambient_light[known]
    if plain:
        return fit_plain(envelope.range, envelope.dark, ambient_min, first, active)
    return fit_lower_envelope(
        envelope.dark_range, envelope.dark, envelope.deviation, ambient_min, first,
        clear_water, active, range_error,
        np.array([brightest_patch(envelope, c) for c in range(3)]),
        patches=np.stack((
            np.broadcast_to(envelope.range, envelope.bright.shape), envelope.bright,
            envelope.step), axis=2))
