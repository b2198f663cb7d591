# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Status of an estimate: ok, or why it is not assessable."""

from enum import Enum


class Status(str, Enum):
    """Outcome of an estimate: ``ok``, or the reason why it is not assessable.

    Reports, messages, tables and logs contain the values.
    """

    OK = "ok"
    NO_COLOUR = "no colour"
    TOO_FEW_SUPPORT_POINTS = "too few support points"
    TOO_FEW_OBSERVATIONS = "too few observations"
    RANGE_SPREAD_TOO_SMALL = "range spread too small"
    ATTENUATION_UNCERTAIN = "attenuation too uncertain"
    SATURATED = "saturated"
    TOO_DARK = "too dark"
    NO_TEXTURE = "no texture"
    AMBIENT_LIGHT_UNBOUNDED = "ambient light unbounded"
    FIT_FAILED = "fit failed"
    NO_DAYLIGHT_COLOUR = (
        "light is not of daylight's colour (check camera.white_reference, white balance, lamps)"
    )
    GREY_ON_AVERAGE = (
        "images are grey on average, which tells no depth "
        "(automatic white balance? fix it, or set camera.white_reference)"
    )
    CLEARER_THAN_CLEAR_WATER = (
        "clearer than clear sea water by three sigma "
        "(check camera.transfer, white balance, camera.response, calibration)"
    )
    OTHER_TRANSFER = (
        "light over range fits another transfer than the one that was told "
        "(check camera.transfer, flat field)"
    )
    NOT_ONE_WATER = (
        "dark and bright patches over range follow no single water and veil "
        "(check camera.vignetting, camera.transfer; a layer, or a veil that is brighter above?)"
    )
    UNLIKE_TRAINING = (
        "the image is unlike any that the estimator knows "
        "(check camera.transfer, exposure, calibration)"
    )
    STEPS_DISAGREE = (
        "ranges before and after dense matching tell different water "
        "(check calibration and stereo.max_disparity)"
    )
    RANGES_OF_ANOTHER_SCENE = (
        "edges of the image and steps of the ranges coincide no more than by chance "
        "(ranges of another frame, mirrored, or an image of noise?)"
    )
    NO_WATER_TYPE = "attenuation is that of no Jerlov type"
    WATER_TYPE_UNCERTAIN = "attenuation is too uncertain to tell a Jerlov type"
    LIT_BY_LAMPS = "lit by lamps: set lighting.model (and lighting.positions)"
    LIGHT_UNCERTAIN = "daylight or lamps: which of them lights the scene is not certain"
    LEFT_TO_STEP_2 = "under lamps step 2 alone estimates"
    NO_DEPTH_BY_LAMPS = (
        "lamps light the scene, which tells no depth (lighting.model; take the depth sensor's)"
    )

    def __str__(self) -> str:
        return self.value


REFUTING = frozenset((
    Status.CLEARER_THAN_CLEAR_WATER, Status.OTHER_TRANSFER, Status.NOT_ONE_WATER,
    Status.UNLIKE_TRAINING, Status.NO_COLOUR,
))
"""Reasons that contradict the assumptions about water, light or camera."""
