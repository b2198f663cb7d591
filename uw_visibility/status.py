# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Status of an estimate: ok, or why it is not assessable."""

from enum import Enum


class Status(str, Enum):
    """Outcome of an estimate: ``ok``, or the reason why it is not assessable.

    Reports, messages and logs contain the values, tables the words of `replay.columns`.
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
        "light does not have the colour of daylight "
        "(check camera.white_reference, white balance, lamps)"
    )
    GREY_ON_AVERAGE = (
        "images are grey on average, so that their colour does not show the depth "
        "(automatic white balance? fix it, or set camera.white_reference)"
    )
    CLEARER_THAN_CLEAR_WATER = (
        "clearer than clear sea water by three sigma "
        "(check camera.transfer, white balance, camera.response, calibration)"
    )
    OTHER_TRANSFER = (
        "light over range fits a transfer other than the configured one "
        "(check camera.transfer, flat field)"
    )
    NOT_ONE_WATER = (
        "dark and bright patches over range do not fit uniform water and a uniform veil "
        "(check camera.vignetting, camera.transfer; a layer, or a veil that is brighter above?)"
    )
    UNLIKE_TRAINING = (
        "the image is unlike those that the estimator was trained on "
        "(check camera.transfer, exposure, calibration)"
    )
    STEPS_DISAGREE = (
        "steps 1 and 2 give different attenuations "
        "(check calibration and stereo.max_disparity)"
    )
    RANGES_OF_ANOTHER_SCENE = (
        "steps of the ranges coincide with edges of the image no more than by chance "
        "(ranges of another frame, mirrored, or an image of noise?)"
    )
    NO_WATER_TYPE = "attenuation fits no Jerlov type"
    WATER_TYPE_UNCERTAIN = "attenuation is too uncertain for a Jerlov type"
    LIT_BY_LAMPS = "lit by lamps: set lighting.model (and lighting.positions)"
    LIGHT_UNCERTAIN = "uncertain whether daylight or lamps light the scene"
    LEFT_TO_STEP_2 = "under lamps only step 2 estimates the water"
    NO_DEPTH_BY_LAMPS = (
        "lamps light the scene, so that its colour does not show the depth "
        "(lighting.model; use a depth sensor)"
    )

    def __str__(self) -> str:
        return self.value


REFUTING = frozenset((
    Status.CLEARER_THAN_CLEAR_WATER, Status.OTHER_TRANSFER, Status.NOT_ONE_WATER,
    Status.UNLIKE_TRAINING, Status.NO_COLOUR,
))
"""Reasons that contradict the assumptions about water, light or camera."""
