# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Settings of the matcher as the restored images' noise asks for them."""

from __future__ import annotations

from dataclasses import replace

from uw_visibility.config.schema import StereoConfig
from uw_visibility.stereo.denoising import LEAST_NOISE

NOISE_RADIUS = 2
"""Neighbours to each side of a first mean in noise, px, which makes surfaces smooth and not
what is matched by chance."""

# Restored noise, in 8-bit levels of even contrast, from which on the settings are wholly
# those of noisy images.
_FULL_NOISE = 6.0
# Neighbours to each side that the disparity map is averaged over besides: noise moves
# disparities by a pixel or two, and neighbours on a surface tell where between.
_MORE_RADIUS = 5
# A hole is a mismatch rather than an occlusion, and may be wider by so many px.
_MORE_GAP = 15
# After that mean the steps of a surface are so much smaller, and those of chance are not. Somewhat
# smaller segments are enough then.
_SEGMENT_DIFFERENCE, _SEGMENT_SIZE = 0.5, 0.5
# Views that agree by chance mostly do so by two pixels.
_TOLERANCE = 1
CONFIDENCE_FOR_COLOUR = 0.4
"""Least confidence of what colour and water are told of: matches that are less likely would tell
of another water."""

# Least confidence of what is published, where it is more likely right than wrong; less where
# noise begins, so that nothing jumps.
_CONFIDENCE, _CONFIDENCE_RISE = 0.51, 0.14


def settings_in_noise(config: StereoConfig, noise: float) -> StereoConfig:
    """Adapt the matcher's settings to noise; below `LEAST_NOISE` they are the configured ones.

    Parameters
    ----------
    config : StereoConfig
        As configured.
    noise : float
        Restored noise of the median pixel, in 8-bit levels of even contrast; see
        `uw_visibility.stereo.contrast`.

    Returns
    -------
    StereoConfig
    """
    share = min(max((noise - LEAST_NOISE) / (_FULL_NOISE - LEAST_NOISE), 0.0), 1.0)
    if share == 0.0:
        return config
    return replace(
        config,
        smoothing_radius=config.smoothing_radius and (
            config.smoothing_radius + round(share * _MORE_RADIUS)
        ),
        gap_width=config.gap_width and config.gap_width + round(share * _MORE_GAP),
        segment_difference=config.segment_difference * (1.0 - share * (1.0 - _SEGMENT_DIFFERENCE)),
        segment_size=round(config.segment_size * (1.0 - share * (1.0 - _SEGMENT_SIZE))),
        left_right_tolerance=min(config.left_right_tolerance, _TOLERANCE)
        if share > 0.5 else config.left_right_tolerance,
    )


def least_confidence(noise: float) -> float:
    """Least confidence of a match that is worth publishing; 0 below `LEAST_NOISE`.

    Parameters
    ----------
    noise : float
        As for `settings_in_noise`.
    """
    if noise <= LEAST_NOISE:
        return 0.0
    return min(_CONFIDENCE_RISE * noise, _CONFIDENCE)
