# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Cues of attenuation and veil beside the envelopes of the whole image."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.blocking import BLOCKS, blocking
from uw_visibility.images.noise import ROUNDING_VARIANCE
from uw_visibility.images.view import ColourSamples
from uw_visibility.optics.transfer import linear_table
from uw_visibility.water.contrast import (
    Decay,
    contrast_course,
    decay,
    envelope_decay,
    fuse_decays,
)
from uw_visibility.water.observations import Envelopes
from uw_visibility.water.open_water import OpenWater, find_open_water
from uw_visibility.water.position import HalfEnvelopes, observe_halves
from uw_visibility.water.surfaces import surface_statistics
from uw_visibility.water.veil_gradient import (
    PlaceCourse,
    VeilGradient,
    level_envelope,
    level_halves,
    level_samples,
    matters,
    place_course,
)


class Observations(NamedTuple):
    """What an image shows of its dark and bright patches over range.

    Attributes
    ----------
    envelope : Envelopes
    contrast : Decay or None
        Decay of contrast with range.
    halves : HalfEnvelopes or None
        Dark envelopes of halves of the image.
    """

    envelope: Envelopes
    contrast: Decay | None
    halves: HalfEnvelopes | None


class Cues(NamedTuple):
    """What tells of the water beside the envelopes of the whole image.

    Attributes
    ----------
    contrast : Decay or None
        Decay of contrast with range.
    open_water : OpenWater or None
        Open water in view.
    halves : HalfEnvelopes or None
        Dark envelopes of halves of the image.
    coarse : bool
        Whether a rough estimate will do.
    places : PlaceCourse or None
        Where in the image the ranges lie.
    compressed : bool
        Whether the pixels went through a JPEG that was not told of.
    level : Observations or None
        Of the image with open water's veil all over, where its gradient matters.
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
        """How the veil changes over the image, where that matters at the ranges seen."""
        gradient = None if self.open_water is None else self.open_water.gradient
        return gradient if matters(gradient, self.places) else None


def coarse_cues(envelope: Envelopes, active: NDArray[np.bool_]) -> Cues:
    """Return what is quick: a mesh covers open water, and has no outlines."""
    return Cues(envelope_decay(envelope, active), coarse=True)


def gather_cues(
    samples: ColourSamples,
    range_map: NDArray[np.float32],
    valid: NDArray[np.bool_] | None,
    envelope: Envelopes,
    active: NDArray[np.bool_],
    observe_samples: Callable[[ColourSamples], Envelopes],
) -> Cues:
    """Gather decay of contrast with range, open water in view, and envelopes of halves.

    Parameters
    ----------
    samples : ColourSamples
    range_map : (H, W) float32 ndarray
        m; NaN where unknown.
    valid : (H, W) bool ndarray or None
        Pixels that show the scene.
    envelope : Envelopes
        Of the same image.
    active : (3,) bool ndarray
        Channels that count.
    observe_samples : callable
        Takes envelopes of other pixels at the same ranges.

    Returns
    -------
    Cues
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
        level = level_envelope(
            observe_samples(level_samples(samples, gradient)), gradient, places)
        return Observations(
            level, fuse_decays(local, envelope_decay(level, active)),
            level_halves(halves, gradient))

    cues = Cues(
        fuse_decays(local, envelope_decay(envelope, active)),
        find_open_water(codes, ranges, valid, irradiance, envelope),
        halves,
        places=places,
        compressed=not samples.codec_known and blocking(codes) > BLOCKS,
        level_by=level_by,
    )
    gradient = cues.gradient
    return cues if gradient is None else cues._replace(level=level_by(gradient))
