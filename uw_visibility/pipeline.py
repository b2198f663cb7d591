# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""From a stereo pair to the water's state, enhanced images and disparity.

Roser, Dunbabin and Geiger, "Simultaneous Underwater Visibility Assessment,
Enhancement and Improved Stereo", ICRA 2014; `Pipeline.process` is its Fig. 4.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config import PipelineConfig
from uw_visibility.enhancement.matting import Matting
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.errors import InputError
from uw_visibility.pair import blindness, check_pair
from uw_visibility.parallel import Workers
from uw_visibility.result import FrameResult
from uw_visibility.status import Status
from uw_visibility.stereo.contrast import EvenContrast
from uw_visibility.stereo.elas import DenseMatch, Matcher, SupportPoints
from uw_visibility.stereo.interpolation import GapFiller, fill_plane, inpaint
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.assessment import Assessor
from uw_visibility.water.estimation import WaterEstimate, WaterEstimator
from uw_visibility.water.optics import load_response

SIDES = ("left", "right")

# Stands for an image that nobody asked for.
_NOT_WANTED: NDArray[Any] = np.empty((0, 0), np.uint8)

# Fewer support points than this make no mesh worth a plane.
_FEWEST_SUPPORT_POINTS = 10
# So many times the matches with the images exchanged mean that they are.
_EXCHANGED_RATIO = 1.5
# Deviation of a matched disparity, px; the mesh's is that of its points.
_DISPARITY_DEVIATION = 0.3


class Pipeline:
    """The two steps of estimation and enhancement, for one rig.

    Memory is allocated at the first pair of a size and used again; calls from
    several threads are taken one after the other.

    Parameters
    ----------
    rig : StereoRig
        Geometry of the rectified pair.
    config : PipelineConfig, optional
        Parameters.

    Raises
    ------
    InputError
        If the camera's spectral response cannot be loaded.
    """

    def __init__(self, rig: StereoRig, config: PipelineConfig | None = None) -> None:
        self.rig = rig
        self.config = config or PipelineConfig()
        camera = self.config.camera
        self._workers = Workers(self.config.threads)
        self._assessor = Assessor(
            self.config.assessment, load_response(camera.response), camera.white_reference
        )
        self._estimator = WaterEstimator(
            self.config.water, self._assessor.clear_water_attenuation, camera.transfer
        )
        self._restorer = Restorer(self.config.enhancement, camera.transfer, self._workers)
        self._stages: _Stages | None = None
        self._lock = threading.Lock()

    def process(
        self,
        left: NDArray[Any],
        right: NDArray[Any],
        *,
        valid: NDArray[np.bool_] | None = None,
        match_original: bool = False,
        enhance: Collection[str] = SIDES,
    ) -> FrameResult:
        """Assess and enhance one rectified pair.

        Parameters
        ----------
        left, right : ndarray
            ``(H, W, 3)`` RGB or ``(H, W)`` grey; uint8 or uint16.
        valid : ndarray, optional
            ``(H, W)`` bool, the pixels of the left image that show the scene;
            rectification leaves some that do not.
        match_original : bool
            Whether to match the raw pair too, for comparison.
        enhance : collection of str
            Which of the two images are wanted enhanced: "left", "right". The
            estimates do not depend on it.

        Returns
        -------
        FrameResult

        Raises
        ------
        InputError
            If the images do not fit, or show nothing that could be matched.
        """
        left, right = check_pair(left, right)
        with self._lock:
            return self._process(left, right, valid, match_original, enhance)

    def warm_up(self, shape: tuple[int, int], dtype: Any = np.uint8) -> None:
        """Compile what is not compiled yet, and allocate for a size of image.

        Parameters
        ----------
        shape : tuple of int
            Height and width, px.
        dtype : dtype
            uint8 or uint16.
        """
        left, right = _warm_up_pair(shape, np.dtype(dtype))
        with self._lock:
            self._process(left, right, None, True, SIDES)

    def _process(
        self,
        left: NDArray[Any],
        right: NDArray[Any],
        valid: NDArray[np.bool_] | None,
        match_original: bool,
        enhance: Collection[str],
    ) -> FrameResult:
        stages = self._stages_for(left.shape[:2])
        clock = _Clock()

        # Step 1: a coarse map of the raw pair is enough to see the water.
        with clock("support points"):
            stages.describe_raw(left, right)
            support = stages.matcher.support_points()
            stages.refuse_useless_pair(left, right, support)
        original = None
        if match_original:
            with clock("original disparity"):
                original = stages.matcher.dense_disparity(support).left
        with clock("coarse disparity"):
            mesh = stages.matcher.coarse_disparity(support)
        with clock("visibility estimation 1"):
            step1 = self._estimate(left, mesh.left, valid, support)
        with clock("matting"):
            coarse = stages.dense_map(mesh, support, left, right)
        with clock("image enhancement 1"):
            stages.describe_restored(left, right, coarse, step1)

        # Step 2: the restored pair is matched densely, and the water seen again.
        with clock("improved disparity"):
            support2 = stages.matcher.support_points()
            improved = stages.matcher.dense_disparity(support2)
        with clock("interpolation"):
            filled = stages.fill(improved, enhance)
        with clock("visibility estimation 2"):
            water = self._estimate(left, improved.left, valid, support, step1)
        with clock("image enhancement 2"):
            range_left = self._range(filled.left)
            shown = water if left.ndim == 3 else self._estimate_grey(left, improved.left, valid)
            left_enhanced, limited = _NOT_WANTED, _NOT_WANTED.astype(bool)
            if "left" in enhance:
                left_enhanced, limited = self._restorer.restore(left, range_left, shown)
            right_enhanced = _NOT_WANTED
            if "right" in enhance:
                range_right = self._range(filled.right)
                right_enhanced, _ = self._restorer.restore(right, range_right, shown)

        with clock("assessment"):
            visibility = self._assessor.assess(water)
        return FrameResult(
            status=water.status,
            step1=step1,
            water=water,
            visibility=visibility,
            clear_water_attenuation=self._assessor.clear_water_attenuation,
            disparity=improved.left,
            disparity_filled=filled.left,
            range=range_left,
            disparity_original=original,
            left_enhanced=left_enhanced,
            right_enhanced=right_enhanced,
            limited=limited,
            support_points=len(support),
            coverage=_matched_fraction(mesh.left),
            matched_fraction_original=None if original is None else _matched_fraction(original),
            matched_fraction_enhanced=_matched_fraction(improved.left),
            min_disparity=stages.disparities[0],
            max_disparity=stages.disparities[1],
            timing_ms=clock.milliseconds(),
        )

    def _stages_for(self, shape: tuple[int, ...]) -> _Stages:
        size = (shape[0], shape[1])
        if self._stages is None or self._stages.shape != size:
            self._stages = _Stages(size, self.rig, self.config, self._workers)
        return self._stages

    def _estimate(
        self,
        image: NDArray[Any],
        disparity: NDArray[np.float32],
        valid: NDArray[np.bool_] | None,
        support: SupportPoints,
        start: WaterEstimate | None = None,
    ) -> WaterEstimate:
        if len(support) < _FEWEST_SUPPORT_POINTS:
            return WaterEstimate.not_assessable(Status.TOO_FEW_SUPPORT_POINTS)
        range_error = _DISPARITY_DEVIATION / (self.rig.focal_length * self.rig.baseline)
        range_map = self.rig.range_from_disparity(disparity)
        return self._estimator.estimate(image, range_map, valid, start, range_error)

    def _estimate_grey(
        self,
        image: NDArray[Any],
        disparity: NDArray[np.float32],
        valid: NDArray[np.bool_] | None,
    ) -> _GreyWater:
        """What restores a grey image's contrast: it has no colour to be assessed."""
        found = self._estimator.estimate_grey(
            image, self.rig.range_from_disparity(disparity), valid
        )
        attenuation, ambient_light = found or (np.nan, np.nan)
        return _GreyWater(np.array([attenuation]), np.array([ambient_light]))

    def _range(self, disparity: NDArray[np.float32]) -> NDArray[np.float32]:
        """Range of a filled map: at or beyond infinity it is infinite."""
        range_map = self.rig.range_from_disparity(disparity)
        range_map[np.isnan(range_map) & np.isfinite(disparity)] = np.inf
        return range_map


class _GreyWater(NamedTuple):
    """Attenuation and ambient light of the one channel of a grey image."""

    attenuation: NDArray[np.float64]
    ambient_light: NDArray[np.float64]


class _Stages:
    """The parts of the pipeline that hold memory for one size of image."""

    def __init__(
        self,
        shape: tuple[int, int],
        rig: StereoRig,
        config: PipelineConfig,
        workers: Workers,
    ) -> None:
        self.shape = shape
        self.disparities = _disparity_limits(config, shape[1])
        self.matcher = Matcher(shape, self.disparities, config.stereo, workers)
        self._rig = rig
        self._config = config
        self._workers = workers
        self._contrast = (EvenContrast(shape), EvenContrast(shape))
        self._matting = Matting(config.enhancement, workers)
        self._gaps = GapFiller(shape, config.enhancement.max_gap, workers)

    def describe_raw(self, left: NDArray[Any], right: NDArray[Any]) -> None:
        """Describe the pair for the matcher as it is."""
        for contrast, image in zip(self._contrast, (left, right), strict=True):
            contrast.stretch(image, self._workers)
        self.matcher.describe(*self._contrast)

    def describe_restored(
        self, left: NDArray[Any], right: NDArray[Any], coarse: DenseMatch, water: WaterEstimate
    ) -> None:
        """Describe the pair with its contrast restored; without estimate the raw pair stays."""
        if left.ndim == 2 or not np.isfinite(water.attenuation).any():
            return
        for contrast, image, disparity in zip(
            self._contrast, (left, right), (coarse.left, coarse.right), strict=True
        ):
            contrast.restore(
                image, self._rig.range_from_disparity(disparity),
                water.attenuation, water.ambient_light, self._workers,
            )
        self.matcher.describe(*self._contrast)

    def refuse_useless_pair(
        self, left: NDArray[Any], right: NDArray[Any], support: SupportPoints
    ) -> None:
        """Raise where few support points have a cause that no water explains.

        Exchanged images still match here and there, and what follows from that
        would be invented.
        """
        if len(support) < _FEWEST_SUPPORT_POINTS:
            for side, image in (("left", left), ("right", right)):
                reason = blindness(image)
                if reason is not Status.OK:
                    raise InputError(f"{side} image: {reason}; nothing can be matched")
        if self.matcher.exchanged_ratio() > _EXCHANGED_RATIO:
            raise InputError(
                "the images match with negative disparities only: exchange left and right"
            )

    def dense_map(
        self, mesh: DenseMatch, support: SupportPoints, left: NDArray[Any], right: NDArray[Any]
    ) -> DenseMatch:
        """Refine the mesh against the images; a thin mesh is helped by the dominant plane."""
        refined = []
        for image, coarse in ((left, mesh.left), (right, mesh.right)):
            filled, _ = fill_plane(coarse, support.points)
            refined.append(self._matting.refine(filled, None, image).disparity)
        return DenseMatch(refined[0], refined[1])

    def fill(self, match: DenseMatch, views: Collection[str]) -> DenseMatch:
        """Fill gaps, then large areas, of the views wanted; another one is NaN throughout."""
        filled = DenseMatch(np.full_like(match.left, np.nan), np.full_like(match.right, np.nan))
        if "left" in views:
            left = self._gaps.fill(match.left, match.right_unchecked)
            filled = replace(filled, left=inpaint(left, self._workers))
        if "right" in views:
            # Seen in a mirror, the right view is a left one.
            right = self._gaps.fill(_mirrored(match.right), _mirrored(match.left_unchecked))
            filled = replace(filled, right=_mirrored(inpaint(right, self._workers)))
        return filled


class _Clock:
    """Durations of the stages of one frame."""

    def __init__(self) -> None:
        self._begin = time.perf_counter()
        self._stages: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self._stages[stage] = 1e3 * (time.perf_counter() - begin)

    def milliseconds(self) -> dict[str, float]:
        """Return the stages and ``total``."""
        return {**self._stages, "total": 1e3 * (time.perf_counter() - self._begin)}


def _disparity_limits(config: PipelineConfig, width: int) -> tuple[int, int]:
    low = config.stereo.min_disparity
    high = config.stereo.max_disparity or width // 4
    high = min(high, width - 16)
    if high - low < 8:
        raise InputError(
            f"stereo.min_disparity is {low} and the largest disparity {high} px: "
            "leave at least 8 px between them"
        )
    return low, high


def _warm_up_pair(
    shape: tuple[int, int], dtype: np.dtype[Any]
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
    return (left * scale).astype(dtype), (right * scale).astype(dtype)


def _mirrored(image: Any) -> Any:
    return np.ascontiguousarray(image[:, ::-1])


def _matched_fraction(disparity: NDArray[np.float32]) -> float:
    return float(np.count_nonzero(np.isfinite(disparity)) / disparity.size)
