# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The parts of the pipeline that hold memory for one size of image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config import PipelineConfig
from uw_visibility.enhancement.matting import Matting
from uw_visibility.errors import InputError
from uw_visibility.pair import blindness
from uw_visibility.parallel import Workers
from uw_visibility.status import Status
from uw_visibility.stereo.airlight import Airlight, AirlightPrior
from uw_visibility.stereo.contrast import EvenContrast
from uw_visibility.stereo.elas import DenseMatch, Matcher, SupportPoints
from uw_visibility.stereo.interpolation import GapFiller, fill_plane, inpaint
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.stereo.views import in_right_view
from uw_visibility.water.estimation import WaterEstimate

# Fewer support points than this make no mesh worth a plane.
FEWEST_SUPPORT_POINTS = 10
# So many times the matches with the images exchanged mean that they are.
_EXCHANGED_RATIO = 1.5


class Stages:
    """Matching, matting and filling for one size of image, one pair at a time.

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
        self._matting = Matting(config.enhancement, workers)
        self._gaps = GapFiller(shape, config.enhancement.max_gap, workers)

    def describe_raw(self, left: NDArray[Any], right: NDArray[Any]) -> None:
        """Describe the pair for the matcher as it is."""
        for contrast, image in zip(self._contrast, (left, right), strict=True):
            contrast.stretch(image, self._workers)
        self.matcher.describe(*self._contrast)

    def describe_restored(
        self,
        left: NDArray[Any],
        right: NDArray[Any],
        coarse: NDArray[np.float32],
        water: WaterEstimate,
        right_gain: NDArray[np.float64],
    ) -> None:
        """Describe the pair with its contrast restored; without estimate the raw pair stays."""
        if left.ndim == 2 or not np.isfinite(water.attenuation).any():
            return
        disparities = (coarse, in_right_view(coarse, self._workers))
        lights = (water.ambient_light, right_gain * water.ambient_light)
        for contrast, image, disparity, light in zip(
            self._contrast, (left, right), disparities, lights, strict=True
        ):
            contrast.restore(
                image, self.rig.range_from_disparity(disparity), water.attenuation, light,
                self._workers,
            )
        self.matcher.describe(*self._contrast)

    def airlight_prior(
        self, left: NDArray[Any], water: WaterEstimate, support: SupportPoints
    ) -> AirlightPrior | None:
        """Bound ranges by the light that the water adds, as far as the matches agree."""
        if left.ndim == 2 or not self._airlight_used:
            return None
        return self._airlight.prior(left, water, support.points)

    def refuse_useless_pair(
        self, left: NDArray[Any], right: NDArray[Any], support: SupportPoints
    ) -> None:
        """Raise where few support points have a cause that no water explains.

        Exchanged images still match here and there, and what follows from that
        would be invented.

        Raises
        ------
        InputError
            If the images are dark, saturated or of one colour, or exchanged.
        """
        if len(support) < FEWEST_SUPPORT_POINTS:
            for side, image in (("left", left), ("right", right)):
                reason = blindness(image)
                if reason is not Status.OK:
                    raise InputError(f"{side} image: {reason}; nothing can be matched")
        if self.matcher.exchanged_ratio() > _EXCHANGED_RATIO:
            raise InputError(
                "the images match with negative disparities only: exchange left and right"
            )

    def dense_map(
        self, mesh: NDArray[np.float32], support: SupportPoints, left: NDArray[Any]
    ) -> NDArray[np.float32]:
        """Refine the mesh against the image; a thin mesh is helped by the dominant plane."""
        filled, _ = fill_plane(mesh, support.points)
        return self._matting.refine(filled, None, left).disparity

    def fill(self, match: DenseMatch) -> NDArray[np.float32]:
        """Fill gaps of the left view's disparity, then large areas."""
        return inpaint(self._gaps.fill(match.disparity, match.right), self._workers)


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
