# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Explanations of statuses for users in the field."""

from __future__ import annotations

from uw_visibility.status import Status

MEANINGS = {
    Status.NO_COLOUR: "The images are grey; attenuation by colour needs a colour camera.",
    Status.TOO_FEW_SUPPORT_POINTS: "Hardly anything matched: open water, blur, or too murky.",
    Status.TOO_FEW_OBSERVATIONS: "Too few pixels with a known range.",
    Status.RANGE_SPREAD_TOO_SMALL: "Everything in view is about equally far away, so that the "
    "water's part cannot be told from the scene's.",
    Status.ATTENUATION_UNCERTAIN: "Over the ranges in view the water takes so little light that "
    "the scene's own brightness and colours could do the same.",
    Status.SATURATED: "Too many pixels at the largest value.",
    Status.TOO_DARK: "Too little light reaches the camera.",
    Status.NO_TEXTURE: "The image is one colour.",
    Status.AMBIENT_LIGHT_UNBOUNDED: "The ambient light cannot be estimated: neither open water nor "
    "anything bright is in view.",
    Status.FIT_FAILED: "The light that was seen does not follow the model of one water.",
    Status.NO_DAYLIGHT_COLOUR: "The light has not the colour of daylight at any depth: lamps, or a "
    "camera whose white is not the one that was configured.",
    Status.GREY_ON_AVERAGE: "The channels have the same mean, as automatic white balance makes "
    "them, while water would have taken the red: the colour of daylight, which tells the depth, "
    "is lost.",
    Status.OTHER_TRANSFER: "The images look sRGB-encoded where linear is configured, or the "
    "reverse.",
    Status.CLEARER_THAN_CLEAR_WATER: "The water would be clearer than pure sea water: a camera "
    "setting or the calibration is wrong.",
    Status.NOT_ONE_WATER: "Brightness changes with range in a way that uniform water cannot "
    "explain: a layer of other water, vignetting, or a veil that is uneven across the image.",
    Status.UNLIKE_TRAINING: "The image differs from 99.7 % of those that the estimator was trained "
    "on: no estimate of it would be reliable.",
    Status.STEPS_DISAGREE: "The coarse mesh of step 1 and the dense disparities of step 2 give "
    "different attenuations, so that one of them has wrong ranges.",
    Status.RANGES_OF_ANOTHER_SCENE: "Edges of the image and steps of the ranges lie at other "
    "places, as those of two scenes do.",
    Status.NO_WATER_TYPE: "No Jerlov type attenuates the three channels in these proportions.",
    Status.WATER_TYPE_UNCERTAIN: "Several Jerlov types fit the attenuation about equally well.",
    Status.LIT_BY_LAMPS: "Near objects are brighter than far ones, as under lamps, but no lamps "
    "are configured. By day a white board held before dark ground can look the same.",
    Status.LIGHT_UNCERTAIN: "The probability that lamps light the scene, though none are "
    "configured, is between 10 and 50 % (with lighting.model auto between 10 and 90 %). With lamps "
    "an estimate for daylight would be wrong.",
    Status.LEFT_TO_STEP_2: "Under lamps only step 2, with dense ranges, estimates the water.",
    Status.NO_DEPTH_BY_LAMPS: "Depth is estimated from the colour of daylight, and lamps light the "
    "scene.",
}

REMEDIES = {
    Status.NO_COLOUR: "Publish colour images: a Bayer pattern or rgb8 instead of mono8.",
    Status.TOO_FEW_SUPPORT_POINTS: "Go nearer to the scene, or check focus and calibration: rows "
    "of a rectified pair must correspond.",
    Status.TOO_FEW_OBSERVATIONS: "Show more of the scene and less open water; check the "
    "calibration.",
    Status.RANGE_SPREAD_TOO_SMALL: "Tilt the camera, so that near and far are in view together; "
    "over a flat floor leave survey.enabled on.",
    Status.ATTENUATION_UNCERTAIN: "Let near and far be in view together, and some open water; the "
    "farthest should be at least a fifth of the visibility away.",
    Status.SATURATED: "Shorten the exposure or lower the gain.",
    Status.TOO_DARK: "Lengthen the exposure, or light the scene.",
    Status.NO_TEXTURE: "Look for a lens cap, a fogged port or a stuck driver; open water alone "
    "tells nothing.",
    Status.AMBIENT_LIGHT_UNBOUNDED: "Let some open water or something bright be in view.",
    Status.FIT_FAILED: "Look at the frame: lamps, shade and sun beams are the usual causes.",
    Status.NO_DAYLIGHT_COLOUR: "Find camera.white_reference with uw_visibility calibrate, fix the "
    "white balance, and turn lamps off.",
    Status.GREY_ON_AVERAGE: "Fix the camera's white balance, best at daylight's; with one that was "
    "fixed under water find camera.white_reference with uw_visibility calibrate.",
    Status.OTHER_TRANSFER: "Set camera.transfer to the other value; where it is right, set "
    "camera.flat_field.",
    Status.CLEARER_THAN_CLEAR_WATER: "Check camera.transfer, camera.response, the white balance, "
    "and that the rig was calibrated under water.",
    Status.NOT_ONE_WATER: "Set camera.vignetting or camera.flat_field, check camera.transfer; let "
    "some open water be in view, which shows how the veil changes.",
    Status.UNLIKE_TRAINING: "Look at the frame: a mosaic that was not interpolated, exchanged "
    "channels or another image than of a scene under water?",
    Status.STEPS_DISAGREE: "Check the calibration and stereo.max_disparity; look at the "
    "disparity for repeated patterns.",
    Status.RANGES_OF_ANOTHER_SCENE: "Give the ranges of this very image: the same stamp, size and "
    "side, neither mirrored nor cropped.",
    Status.NO_WATER_TYPE: "Take the attenuation itself; check camera.response.",
    Status.WATER_TYPE_UNCERTAIN: "Take the attenuation itself, or more frames together.",
    Status.LIT_BY_LAMPS: "Set lighting.model to lamps, or to both beside daylight, and "
    "lighting.positions to where they are. Without lamps, keep bright objects out of the "
    "foreground.",
    Status.LIGHT_UNCERTAIN: "By day let some open water be in view; with lamps on set "
    "lighting.model to lamps or both, and their places.",
    Status.LEFT_TO_STEP_2: "Nothing: look at the result of the second step.",
    Status.NO_DEPTH_BY_LAMPS: "Take the depth sensor's; by day turn lamps off.",
}


def meaning(status: str) -> str:
    """Return what a status means and what to do; empty where there is nothing to add."""
    try:
        known = Status(status)
    except ValueError:
        return ""
    return f"{MEANINGS[known]} {REMEDIES[known]}" if known in MEANINGS else ""
