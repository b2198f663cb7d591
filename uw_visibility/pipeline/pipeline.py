# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""From a stereo pair to the water's state, enhanced images and disparity.

Roser, Dunbabin and Geiger, "Simultaneous Underwater Visibility Assessment,
Enhancement and Improved Stereo", ICRA 2014; `Pipeline.process` is its Fig. 4.
"""

from __future__ import annotations

import threading
from collections.abc import Collection
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.images.chroma import ChromaImage
from uw_visibility.images.pair import check_pair
from uw_visibility.images.view import View
from uw_visibility.images.vignetting import EvenIllumination
from uw_visibility.optics.spectra import load_response
from uw_visibility.pipeline.first_step import FirstLook, FirstStep
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.pipeline.second_step import (
    FEWEST_SUPPORT_POINTS,
    Stages,
    disparity_limits,
    range_error,
    warm_up_pair,
)
from uw_visibility.pipeline.timing import StageClock
from uw_visibility.status import Status
from uw_visibility.stereo.pyramid import Reduction
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.stereo.views import in_right_view
from uw_visibility.water.assessment import Assessor
from uw_visibility.water.estimation import WaterEstimate, WaterEstimator
from uw_visibility.water.tracking import WaterTracker

SIDES = ("left", "right")

# Stands for an image that nobody asked for.
_NOT_WANTED: NDArray[Any] = np.empty((0, 0), np.uint8)

# Deviation of a matched disparity, px.
_DISPARITY_DEVIATION = 0.3


class Pipeline:
    """The two steps of estimation and enhancement, for one rig.

    Memory is allocated at the first pair of a size and used again; calls from
    several threads are taken one after the other. Frames that come with a stamp
    are filtered over time besides; each frame's own estimate does not depend on
    others, so that frames may be processed in any order and in parallel.

    Parameters
    ----------
    rig : StereoRig
        Geometry of the rectified pair.
    config : PipelineConfig, optional
        Parameters.
    workers : Workers, optional
        Threads, shared with other pipelines; its own where absent.

    Raises
    ------
    InputError
        If the camera's spectral response or flat field cannot be loaded.
    """

    def __init__(
        self,
        rig: StereoRig,
        config: PipelineConfig | None = None,
        workers: Workers | None = None,
    ) -> None:
        self.rig = rig
        self.config = config or PipelineConfig()
        camera = self.config.camera
        self._workers = workers or Workers(self.config.threads)
        self._assessor = Assessor(
            self.config.assessment, load_response(camera.response), camera.white_reference
        )
        self._estimator = WaterEstimator(
            self.config.water, self._assessor.clear_water_attenuation, camera.transfer,
            self._assessor.daylight,
        )
        self._restorer = Restorer(self.config.enhancement, camera.transfer, self._workers)
        self._illumination = EvenIllumination(
            camera, (rig.principal_point, rig.principal_point_right or rig.principal_point),
            self._workers,
        )
        tracking = self.config.tracking
        self._tracker = WaterTracker(tracking) if tracking.enabled else None
        self._tracking_lock = threading.Lock()
        self._reduction = Reduction(self.config.stereo.reduction, self._workers)
        self._first_step: FirstStep | None = None
        self._stages: Stages | None = None
        self._whole_size: tuple[int, int] | None = None
        self._lock = threading.Lock()

    def process(
        self,
        left: NDArray[Any],
        right: NDArray[Any],
        *,
        valid: NDArray[np.bool_] | None = None,
        match_original: bool = False,
        enhance: Collection[str] = SIDES,
        stamp: float | None = None,
        confidence: bool = True,
        colour: ChromaImage | None = None,
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
        stamp : float, optional
            Time of the pair, s, for the recursion over frames; without one, the
            pair neither uses nor changes what earlier ones left.
        confidence : bool
            Whether to rate the disparities.
        colour : ChromaImage, optional
            Colour of the left image as its codec left it, which the water is then read
            from: of a JPEG or a mosaic, see `uw_visibility.images.chroma`.

        Returns
        -------
        FrameResult

        Raises
        ------
        InputError
            If the images do not fit, or show nothing that could be matched.
        """
        left, right = check_pair(left, right)
        with self._lock, self._workers.shared():
            result = self._process(
                left, right, valid, match_original, enhance, confidence, colour
            )
        return result if stamp is None else self.track(result, stamp)

    def track(self, result: FrameResult, stamp: float) -> FrameResult:
        """Filter a frame's estimate over the frames before, as `process` does with a stamp.

        For frames that are processed without one, by this or by another pipeline like it,
        so that they may overlap: they are tracked in their order.

        Parameters
        ----------
        result : FrameResult
            What `process` said of the frame.
        stamp : float
            Time of the frame, s.

        Returns
        -------
        FrameResult
            The same with `tracked`, `tracked_visibility` and `tracking`.
        """
        if self._tracker is None:
            return result
        clock = StageClock()
        with self._tracking_lock, clock("tracking"):
            tracked = self._tracker.update(result.water, stamp)
            event = self._tracker.event
        visibility = self._assessor.assess(tracked)
        times = clock.milliseconds()
        times["total"] += result.timing_ms["total"]
        return replace(
            result, tracked=tracked, tracked_visibility=visibility, tracking=event,
            timing_ms=result.timing_ms | times,
        )

    def first_look(self, left: NDArray[Any], right: NDArray[Any]) -> FirstLook:
        """Take step 1 alone, as `process` does.

        Parameters
        ----------
        left, right : ndarray
            See `process`.

        Returns
        -------
        FirstLook

        Raises
        ------
        InputError
            If the images do not fit, or show nothing that could be matched.
        """
        left, right = check_pair(left, right)
        with self._lock:
            if self._illumination.needed:
                left, right = self._illumination.correct(left, right)
            first_step, _ = self._steps_for(left.shape[:2])
            transfer = self.config.camera.transfer
            views = View.of(left, transfer), View.of(right, transfer)
            return first_step.look(*views, self._estimator, StageClock())

    def reset_tracking(self) -> None:
        """Forget what earlier frames told of the water."""
        with self._tracking_lock:
            if self._tracker is not None:
                self._tracker.reset()

    def warm_up(
        self,
        shape: tuple[int, int],
        dtype: Any = np.uint8,
        *,
        grey: bool = False,
        compressed: bool = False,
    ) -> None:
        """Compile what is not compiled yet, and allocate for a size of image.

        Parameters
        ----------
        shape : tuple of int
            Height and width, px.
        dtype : dtype
            uint8 or uint16.
        grey : bool
            Whether the images will be grey ones.
        compressed : bool
            Whether they may be JPEG.
        """
        left, right = check_pair(*warm_up_pair(shape, np.dtype(dtype), grey=grey))
        with self._lock:
            self._process(left, right, None, True, SIDES, True, None)
            if compressed:
                # Imported here, since images without loss need none of it.
                from uw_visibility.images.jpeg import warm_up_chroma

                self._process(left, right, None, False, (), False, warm_up_chroma(left))

    def allocate(self, shape: tuple[int, int]) -> None:
        """Allocate for a size of image, as its first pair would.

        Parameters
        ----------
        shape : tuple of int
            Height and width, px.

        Raises
        ------
        InputError
            If pairs of that size cannot be processed with these parameters.
        """
        with self._lock:
            self._illumination.allocate(shape)
            self._steps_for(shape)

    def _process(
        self,
        left: NDArray[Any],
        right: NDArray[Any],
        valid: NDArray[np.bool_] | None,
        match_original: bool,
        enhance: Collection[str],
        confidence: bool,
        colour: ChromaImage | None,
    ) -> FrameResult:
        first_step, stages = self._steps_for(left.shape[:2])
        clock = StageClock()
        if self._illumination.needed:
            with clock("even illumination"):
                left, right = self._illumination.correct(left, right)
                colour = self._illumination.correct_chroma(colour)
        transfer = self.config.camera.transfer
        left_view = View.of(left, transfer, valid, colour)
        right_view = View.of(right, transfer)
        reduced = self._reduction.factor(left.shape) > 1
        if reduced:
            with clock("reduction"):
                left, right = self._reduction.image(left), self._reduction.image(right)

        first = first_step.look(left_view, right_view, self._estimator, clock)
        step1, gain = first.water, first.right_gain
        original = None
        if match_original:
            with clock("original disparity"):
                original = stages.match_raw(left, right)
        with clock("image enhancement 1"):
            stages.describe_restored(left, right, first.disparity, first.rig, step1, gain)
            points = self._reduction.points(first.points, left_view.shape)
            noise = None if reduced else left_view.noise
            airlight = stages.airlight_prior(left, step1, points, noise)

        # Step 2: the restored pair is matched densely, and the water seen again.
        with clock("improved disparity"):
            support = stages.matcher.support_points(airlight, points)
            improved = stages.matcher.dense_disparity(support, airlight, confidence=confidence)
        size = left_view.shape
        disparity, rated = improved.disparity, improved.confidence
        if reduced:
            with clock("full size"):
                disparity = self._reduction.disparity(disparity, size)
                if rated is not None:
                    rated = self._reduction.confidence(rated, disparity)
                if original is not None:
                    original = self._reduction.disparity(original, size)

        def fill() -> NDArray[np.float32]:
            # What is filled serves colour only.
            if not enhance:
                return np.full_like(disparity, np.nan)
            with clock("interpolation"):
                return self._reduction.disparity(stages.fill(improved), size)

        def estimate() -> WaterEstimate:
            with clock("visibility estimation 2"):
                if len(support) < FEWEST_SUPPORT_POINTS:
                    return WaterEstimate.not_assessable(Status.TOO_FEW_SUPPORT_POINTS)
                return self._estimate(disparity, first)

        filled, water = self._workers.together(fill, estimate)
        with clock("image enhancement 2"):
            if left.ndim == 2:
                shown = self._estimate_grey(left_view, disparity)
            else:
                shown = _first_known(water, step1)
            (range_left, left_enhanced, limited), right_enhanced = self._workers.together(
                lambda: self._restore_left(left_view, filled, shown, enhance),
                lambda: self._restore_right(right_view, filled, shown, gain, enhance),
            )

        with clock("assessment"):
            visibility = self._assessor.assess(water)
        low, high = disparity_limits(self.config, size[1])
        return FrameResult(
            status=water.status,
            step1=step1,
            water=water,
            visibility=visibility,
            clear_water_attenuation=self._assessor.clear_water_attenuation,
            disparity=disparity,
            disparity_filled=filled,
            range=range_left,
            disparity_original=original,
            left_enhanced=left_enhanced,
            right_enhanced=right_enhanced,
            limited=limited,
            support_points=len(first.points),
            coverage=first.coverage,
            matched_fraction_original=None if original is None else _matched_fraction(original),
            matched_fraction_enhanced=_matched_fraction(disparity),
            min_disparity=low,
            max_disparity=high,
            timing_ms=clock.milliseconds(),
            right_gain=gain,
            confidence=rated,
        )

    def _steps_for(self, shape: tuple[int, ...]) -> tuple[FirstStep, Stages]:
        size = (shape[0], shape[1])
        if self._first_step is None or self._stages is None or self._whole_size != size:
            reduction = self._reduction
            config = replace(self.config, stereo=reduction.settings(self.config.stereo, size))
            self._stages = Stages(
                reduction.shape(size), reduction.rig(self.rig, size), config, self._workers
            )
            self._first_step = FirstStep(size, self.rig, self.config, self._workers)
            self._whole_size = size
        return self._first_step, self._stages

    def _estimate(self, disparity: NDArray[np.float32], first: FirstLook) -> WaterEstimate:
        return self._estimator.estimate_view(
            first.view, self.rig.range_from_disparity(disparity), start=first.water,
            range_error=range_error(self.rig, _DISPARITY_DEVIATION),
        )

    def _estimate_grey(self, view: View, disparity: NDArray[np.float32]) -> _Water:
        """What restores a grey image's contrast: it has no colour to be assessed."""
        found = self._estimator.estimate_grey_view(
            view, self.rig.range_from_disparity(disparity),
            range_error=range_error(self.rig, _DISPARITY_DEVIATION),
        )
        attenuation, ambient_light = found or (np.nan, np.nan)
        return _Water(np.array([attenuation]), np.array([ambient_light]))

    def _restore_left(
        self,
        view: View,
        filled: NDArray[np.float32],
        water: _Water,
        enhance: Collection[str],
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[np.bool_]]:
        """Return the range of each pixel, the image restored, and where gain was limited."""
        range_map = self._range(filled)
        if "left" not in enhance:
            return range_map, _NOT_WANTED, _NOT_WANTED.astype(bool)
        return range_map, *self._restorer.restore(view.pixels, range_map, water, view.noise)

    def _restore_right(
        self,
        view: View,
        filled: NDArray[np.float32],
        water: _Water,
        gain: NDArray[np.float64],
        enhance: Collection[str],
    ) -> NDArray[Any]:
        if "right" not in enhance:
            return _NOT_WANTED
        range_map = self._range(in_right_view(filled, self._workers))
        brighter = _Water(water.attenuation, gain * water.ambient_light)
        restored, _ = self._restorer.restore(view.pixels, range_map, brighter, view.noise)
        return restored

    def _range(self, disparity: NDArray[np.float32]) -> NDArray[np.float32]:
        """Range of a filled map: at or beyond infinity it is infinite."""
        range_map = self.rig.range_from_disparity(disparity)
        range_map[np.isnan(range_map) & np.isfinite(disparity)] = np.inf
        return range_map


class _Water(NamedTuple):
    """Attenuation and ambient light of each channel of an image."""

    attenuation: NDArray[np.float64]
    ambient_light: NDArray[np.float64]


def _first_known(water: WaterEstimate, step1: WaterEstimate) -> _Water:
    """Take each channel from step 2, or else from step 1.

    A channel that step 2 refuses is restored with what step 1 says of it: an
    image is worth more than none, and the estimate itself stays refused.
    """
    missing = np.isnan(water.attenuation)
    return _Water(
        np.where(missing, step1.attenuation, water.attenuation),
        np.where(missing, step1.ambient_light, water.ambient_light),
    )


def _matched_fraction(disparity: NDArray[np.float32]) -> float:
    return float(np.count_nonzero(np.isfinite(disparity)) / disparity.size)
