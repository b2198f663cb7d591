# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Explanations of statuses for users in the field."""

from __future__ import annotations

from uw_visibility.status import Status

MEANINGS: dict[str, str] = {
    Status.NO_COLOUR: "The images are grey; attenuation by colour needs a colour camera.",
    Status.TOO_FEW_SUPPORT_POINTS: "Hardly anything of the left image is found in the right "
    "one: open water, blur, turbid water, noise, or images that do not belong together.",
    Status.TOO_FEW_OBSERVATIONS: "Too few pixels with a known range.",
    Status.RANGE_SPREAD_TOO_SMALL: "Everything in view is about equally far away, so that the "
    "effect of the water cannot be separated from the scene.",
    Status.ATTENUATION_UNCERTAIN: "Over the ranges in view the water absorbs so little light "
    "that differences within the scene could look the same.",
    Status.SATURATED: "Too many pixels at the largest value.",
    Status.TOO_DARK: "Too little light reaches the camera.",
    Status.NO_TEXTURE: "The image has almost no contrast.",
    Status.AMBIENT_LIGHT_UNBOUNDED: "The depth is too uncertain: its standard deviation exceeds "
    "half of assessment.max_depth.",
    Status.FIT_FAILED: "The light in the image does not fit the model of uniform water.",
    Status.NO_DAYLIGHT_COLOUR: "The light does not have the colour of daylight at any depth: "
    "lamps, or the camera's white differs from the configured one.",
    Status.GREY_ON_AVERAGE: "The channels have the same mean, although water absorbs red: "
    "automatic white balance has removed the colour of daylight, from which depth is estimated.",
    Status.OTHER_TRANSFER: "The images look sRGB-encoded where linear is configured, or the "
    "reverse.",
    Status.CLEARER_THAN_CLEAR_WATER: "The water would be clearer than pure sea water: a camera "
    "setting or the calibration is wrong.",
    Status.NOT_ONE_WATER: "Brightness changes with range in a way that uniform water cannot "
    "explain: a layer of other water, vignetting, or a veil that is uneven across the image; under "
    "lamps, patches differ more than those of any ground.",
    Status.UNLIKE_TRAINING: "The image is less like the training images than 99.7 % of them: no "
    "estimate from it would be reliable.",
    Status.STEPS_DISAGREE: "The coarse mesh of step 1 and the dense disparities of step 2 give "
    "different attenuations: the ranges of one step are wrong.",
    Status.RANGES_OF_ANOTHER_SCENE: "Edges of the image and steps of the ranges do not coincide: "
    "image and ranges seem to show different scenes.",
    Status.NO_WATER_TYPE: "No Jerlov type attenuates the three channels in these proportions.",
    Status.WATER_TYPE_UNCERTAIN: "Several Jerlov types fit the attenuation about equally well.",
    Status.LIT_BY_LAMPS: "Near objects are brighter than far ones, as under lamps, but no lamps "
    "are configured. By day a white board held before dark ground, or an image of which a part is "
    "black, can look the same.",
    Status.LIGHT_UNCERTAIN: "The probability that lamps light the scene, though none are "
    "configured, is between 3 and 50 % (with lighting.model auto between 10 and 90 %). Under "
    "lamps an estimate for daylight would be wrong.",
    Status.LEFT_TO_STEP_2: "Under lamps only step 2, with dense ranges, estimates the water.",
    Status.NO_DEPTH_BY_LAMPS: "Depth is estimated from the colour of daylight, but lamps light the "
    "scene.",
}

REMEDIES: dict[str, str] = {
    Status.NO_COLOUR: "Give colour images; as a topic a Bayer pattern or rgb8 instead of mono8.",
    Status.TOO_FEW_SUPPORT_POINTS: "Go closer to the scene, or check focus and calibration: rows "
    "of a rectified pair must correspond.",
    Status.TOO_FEW_OBSERVATIONS: "Show more of the scene and less open water; check the "
    "calibration.",
    Status.RANGE_SPREAD_TOO_SMALL: "Tilt the camera, so that near and far objects are in view "
    "together; over a flat floor leave survey.enabled on.",
    Status.ATTENUATION_UNCERTAIN: "Have near and far objects in view together, and some open "
    "water; the farthest should be at least a fifth of the visibility distance away.",
    Status.SATURATED: "Shorten the exposure or lower the gain.",
    Status.TOO_DARK: "Lengthen the exposure, or light the scene.",
    Status.NO_TEXTURE: "Look for a lens cap, a fogged port or a stuck driver; open water alone "
    "is not enough.",
    Status.AMBIENT_LIGHT_UNBOUNDED: "Find camera.white_reference and assessment.water_type with "
    "uw_visibility calibrate.",
    Status.FIT_FAILED: "Look at the frame: lamps, shade and sun beams are the usual causes.",
    Status.NO_DAYLIGHT_COLOUR: "Find camera.white_reference with uw_visibility calibrate, fix the "
    "white balance, and turn lamps off.",
    Status.GREY_ON_AVERAGE: "Fix the camera's white balance, preferably at daylight; if it was "
    "fixed under water, find camera.white_reference with uw_visibility calibrate.",
    Status.OTHER_TRANSFER: "Set camera.transfer to the other value; if it was right, set "
    "camera.flat_field.",
    Status.CLEARER_THAN_CLEAR_WATER: "Check camera.transfer, camera.response, the white balance, "
    "and that the rig was calibrated under water.",
    Status.NOT_ONE_WATER: "Set camera.vignetting or camera.flat_field, check camera.transfer; have "
    "some open water in view, which shows how the veil changes. Under lamps, check their positions "
    "and directions, or go closer.",
    Status.UNLIKE_TRAINING: "Look at the frame: a Bayer mosaic without interpolation, exchanged "
    "channels, or no underwater scene?",
    Status.STEPS_DISAGREE: "Check the calibration and stereo.max_disparity; look for "
    "repeated patterns in the disparity.",
    Status.RANGES_OF_ANOTHER_SCENE: "Give the ranges of this image: same stamp, size and side, "
    "neither mirrored nor cropped.",
    Status.NO_WATER_TYPE: "Use the attenuation itself; check camera.response.",
    Status.WATER_TYPE_UNCERTAIN: "Use the attenuation itself, or more frames together.",
    Status.LIT_BY_LAMPS: "Set lighting.model to lamps, or to both if there is daylight too, and "
    "lighting.positions to the lamps' positions. Without lamps, keep bright objects out of the "
    "foreground, and the housing's edge out of view.",
    Status.LIGHT_UNCERTAIN: "By day have some open water in view; with lamps on set "
    "lighting.model to lamps or both, and lighting.positions.",
    Status.LEFT_TO_STEP_2: "Nothing: look at the result of step 2.",
    Status.NO_DEPTH_BY_LAMPS: "Use a depth sensor; by day turn the lamps off.",
}


def meaning(status: str) -> str:
    """Return what a status means and what to do; empty where there is nothing to add."""
    return f"{MEANINGS[status]} {REMEDIES[status]}" if status in MEANINGS else ""
