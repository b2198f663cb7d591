# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The parts of the pipeline that hold memory for one size of image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.stereo.airlight import Airlight, AirlightPrior
from uw_visibility.stereo.contrast import EvenContrast
from uw_visibility.stereo.elas import DenseMatch, Matcher
from uw_visibility.stereo.interpolation import GapFiller, inpaint
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.stereo.views import in_right_view
from uw_visibility.water.estimation import WaterEstimate

# Fewer support points than this make no mesh worth a plane.
FEWEST_SUPPORT_POINTS = 10


class Stages:
    """Matching and filling for one size of image, one pair at a time.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the images, px.
    rig : StereoRig
        Geometry of the pair.
    config : PipelineConfig
        Parameters.
    workers : Workers
        Threads.

    Raises
    ------
    InputError
        If the limits of the disparity leave nothing to search.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        rig: StereoRig,
        config: PipelineConfig,
        workers: Workers,
    ) -> None:
        self.shape = shape
        self.disparities = disparity_limits(config, shape[1])
        self.matcher = Matcher(shape, self.disparities, config.stereo, workers)
        self.rig = rig
        self._workers = workers
        self._contrast = (EvenContrast(shape), EvenContrast(shape))
        self._airlight = Airlight(
            shape, rig, self.disparities[1] + 2, config.camera.transfer, workers
        )
        self._airlight_used = config.stereo.airlight_prior > 0
        self._gaps = GapFiller(shape, config.enhancement.max_gap, workers)

    def describe_raw(self, left: NDArray[Any], right: NDArray[Any]) -> None:
        """Describe the pair for the matcher as it is."""
        describe_raw(self.matcher, self._contrast, (left, right), self._workers)

    def match_raw(self, left: NDArray[Any], right: NDArray[Any]) -> NDArray[np.float32]:
        """Match the pair as it is, for comparison."""
        self.describe_raw(left, right)
        support = self.matcher.support_points()
        return self.matcher.dense_disparity(support, confidence=False).disparity

    def describe_restored(
        self,
        left: NDArray[Any],
        right: NDArray[Any],
        coarse: NDArray[np.float32],
        rig: StereoRig,
        water: WaterEstimate,
        right_gain: NDArray[np.float64],
    ) -> None:
        """Describe the pair with its contrast restored; without estimate as it is.

        Parameters
        ----------
        left, right : ndarray
            ``(H, W, 3)`` or ``(H, W)``; uint8 or uint16.
        coarse : ndarray
            ``(h, w)`` float32, dense disparity of the left view at this size or at a
            fraction of it, px.
        rig : StereoRig
            Geometry at the size of `coarse`.
        water : WaterEstimate
            Attenuation and ambient light.
        right_gain : ndarray
            ``(3,)`` float64, irradiance in the right image over that in the left.
        """
        if left.ndim == 2 or not np.isfinite(water.attenuation).any():
            self.describe_raw(left, right)
            return

        def describe(side: int, image: NDArray[Any]) -> None:
            disparity = in_right_view(coarse, self._workers) if side else coarse
            light = right_gain * water.ambient_light if side else water.ambient_light
            self._contrast[side].restore(
                image, rig.range_from_disparity(disparity), water.attenuation, light,
                self._workers,
            )
            self.matcher.describe_view(side, self._contrast[side])

        self._workers.together(lambda: describe(0, left), lambda: describe(1, right))

    def airlight_prior(
        self,
        left: NDArray[Any],
        water: WaterEstimate,
        points: NDArray[np.float32],
        noise: NDArray[np.float64] | None = None,
    ) -> AirlightPrior | None:
        """Bound ranges by the light that the water adds, as far as matches ``(N, 3)`` agree."""
        if left.ndim == 2 or not self._airlight_used:
            return None
        return self._airlight.prior(left, water, points, noise)

    def fill(self, match: DenseMatch) -> NDArray[np.float32]:
        """Fill gaps of the left view's disparity, then large areas."""
        return inpaint(self._gaps.fill(match.disparity, match.right), self._workers)


def describe_raw(
    matcher: Matcher,
    contrast: tuple[EvenContrast, EvenContrast],
    pair: tuple[NDArray[Any], NDArray[Any]],
    workers: Workers,
) -> None:
    """Describe a pair for a matcher as it is.

    Parameters
    ----------
    matcher : Matcher
        Of the size of the images.
    contrast : tuple of EvenContrast
        Of the left and of the right view; overwritten, and used until the pair is matched.
    pair : tuple of ndarray
        ``(H, W, 3)`` or ``(H, W)``; uint8 or uint16.
    workers : Workers
        Threads.
    """

    def describe(side: int) -> None:
        contrast[side].stretch(pair[side], workers)
        matcher.describe_view(side, contrast[side])

    workers.together(lambda: describe(0), lambda: describe(1))


def range_error(rig: StereoRig, deviation: float) -> float:
    """Standard deviation of range over its square, 1/m, for that of the disparity, px."""
    return deviation / (rig.focal_length * rig.baseline)


def disparity_limits(config: PipelineConfig, width: int) -> tuple[int, int]:
    """Return the smallest and the largest disparity searched, px.

    Raises
    ------
    InputError
        If they leave nothing to search.
    """
    low = config.stereo.min_disparity
    high = config.stereo.max_disparity or width // 4
    high = min(high, width - 16)
    if high - low < 8:
        raise InputError(
            f"stereo.min_disparity is {low} and the largest disparity {high} px: "
            "leave at least 8 px between them"
        )
    return low, high


def warm_up_pair(
    shape: tuple[int, int], dtype: np.dtype[Any], *, grey: bool = False
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return a pair of three planes under water, which every stage has work with."""
    height, width = shape
    texture = np.random.default_rng(0).random((height, width, 3))
    left, right = np.empty((2, height, width, 3))
    for part, disparity in enumerate((12, 8, 5)):
        rows = slice(part * height // 3, (part + 1) * height // 3)
        transmission = np.exp(-np.array([0.5, 0.3, 0.2]) * 16 / disparity)
        left[rows] = (1 - transmission) + transmission * texture[rows]
        right[rows] = np.roll(left[rows], -disparity, axis=1)
    scale = 0.8 * np.iinfo(dtype).max
    first, second = ((scale * image).astype(dtype) for image in (left, right))
    return (first[..., 1], second[..., 1]) if grey else (first, second)
