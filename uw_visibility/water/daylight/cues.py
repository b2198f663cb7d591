# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Cues of attenuation and veil beside the envelopes of the whole image."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Mask
from uw_visibility.images.blocking import BLOCKS, blocking
from uw_visibility.images.noise import ROUNDING_VARIANCE
from uw_visibility.images.view import ColourSamples
from uw_visibility.optics.transfer import linear_table
from uw_visibility.water.daylight.contrast import (
    Decay,
    contrast_course,
    decay,
    envelope_decay,
    fuse_decays,
)
from uw_visibility.water.daylight.open_water import OpenWater, find_open_water
from uw_visibility.water.daylight.position import HalfEnvelopes, observe_halves
from uw_visibility.water.daylight.surfaces import surface_statistics
from uw_visibility.water.daylight.veil_gradient import (
    PlaceCourse,
    VeilGradient,
    level_envelope,
    level_halves,
    level_samples,
    matters,
    place_course,
)
from uw_visibility.water.observations import Envelopes


class Observations(NamedTuple):
    """Envelopes of the image, decay of contrast, and dark envelopes of its halves."""

    envelope: Envelopes
    contrast: Decay | None
    halves: HalfEnvelopes | None


class Cues(NamedTuple):
    """Cues of the water beside the envelopes of the whole image.

    Attributes
    ----------
    contrast : Decay or None
    open_water : OpenWater or None
    halves : HalfEnvelopes or None
        Dark envelopes of halves of the image.
    coarse : bool
        Whether a rough estimate will do.
    places : PlaceCourse or None
        Mean place in the image over range.
    compressed : bool
        Whether the pixels went through a JPEG that the caller did not declare.
    level : Observations or None
        Observations with the gradient of open water levelled, where it matters.
    level_by : callable or None
        Levels the image by a gradient.
    """

    contrast: Decay | None = None
    open_water: OpenWater | None = None
    halves: HalfEnvelopes | None = None
    coarse: bool = False
    places: PlaceCourse | None = None
    compressed: bool = False
    level: Observations | None = None
    level_by: Callable[[VeilGradient], Observations] | None = None

    @property
    def certain_water(self) -> OpenWater | None:
        """Open water in view that is certainly such."""
        water = self.open_water
        return water if water is not None and water.certain else None

    @property
    def gradient(self) -> VeilGradient | None:
        """Gradient of the veil over the image, where it matters at the ranges seen."""
        gradient = None if self.open_water is None else self.open_water.gradient
        return gradient if matters(gradient, self.places) else None


def coarse_cues(envelope: Envelopes, active: Mask) -> Cues:
    """Cues for step 1: envelope contrast only."""
    return Cues(envelope_decay(envelope, active), coarse=True)


def gather_cues(
    samples: ColourSamples, range_map: NDArray[np.float32], valid: Mask | None, envelope: Envelopes,
    active: Mask, observe_samples: Callable[[ColourSamples], Envelopes],
) -> Cues:
    """Gather decay of contrast, open water in view, and dark envelopes of halves.

    `observe_samples` returns the envelopes of other pixels at the same ranges.
    """
    codes, irradiance = samples.pixels, linear_table(samples.transfer, samples.pixels.dtype)
    ranges, valid = samples.reduce(range_map, valid)
    mask = np.ones((1, 1), np.bool_) if valid is None else valid
    rounding = np.sqrt(samples.noise**2 + ROUNDING_VARIANCE)
    surfaces = surface_statistics(codes, ranges, mask, irradiance, envelope.limits)
    local = decay(*contrast_course(surfaces, rounding), active)
    halves = observe_halves(surfaces, rounding * np.nan_to_num(envelope.step).max(axis=1))
    places = place_course(surfaces)

    def level_by(gradient: VeilGradient) -> Observations:
        level = level_envelope(observe_samples(level_samples(samples, gradient)), gradient, places)
        return Observations(
            level, fuse_decays(local, envelope_decay(level, active)),
            level_halves(halves, gradient))

    cues = Cues(
        fuse_decays(local, envelope_decay(envelope, active)),
        find_open_water(codes, ranges, valid, irradiance, envelope, active),
        halves,
        places=places,
        compressed=not samples.codec_known and blocking(codes) > BLOCKS,
        level_by=level_by)
    gradient = cues.gradient
    return cues if gradient is None else cues._replace(level=level_by(gradient))
