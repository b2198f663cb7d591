# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pipeline from a stereo pair to the water's state, enhanced images and disparity.

Roser, Dunbabin and Geiger, "Simultaneous Underwater Visibility Assessment,
Enhancement and Improved Stereo", ICRA 2014; `Pipeline.process` is its Fig. 4.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.radiance import RestorationWater
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Image, Mask, RangeMap
from uw_visibility.images.chroma import ChromaImage
from uw_visibility.images.pair import check_pair, check_valid
from uw_visibility.images.view import StereoViews, View
from uw_visibility.images.vignetting import FlatFieldCorrection
from uw_visibility.pipeline.enhancement import ImageEnhancement
from uw_visibility.pipeline.first_step import CoarseEstimate, FirstStep
from uw_visibility.pipeline.lamps import Estimators, LampEnhancement
from uw_visibility.pipeline.result import FilledStereo, FrameResult, StageClock, StereoResult
from uw_visibility.pipeline.second_step import ImprovedDisparity, SecondStep
from uw_visibility.pipeline.warm_up import warm_up_pair, warm_up_scene
from uw_visibility.status import REFUTING, Status
from uw_visibility.stereo.codec_noise import with_codec_noise
from uw_visibility.stereo.elas import FEWEST_SUPPORT_POINTS
from uw_visibility.stereo.matchers import check_matcher, disparity_limits
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.daylight.validation import compare_steps
from uw_visibility.water.estimate import LampLight, WaterEstimate
from uw_visibility.water.meaning.assessment import Assessor, Visibility

SIDES = ("left", "right")


class Pipeline:
    """Pipeline of estimation and enhancement in two steps, for one rig.

    Memory is allocated at the first pair of a size and reused; calls from several
    threads run one after the other. No state is kept between frames, so that they may
    be processed in any order, and by several pipelines in parallel; see
    `uw_visibility.water.series.filter` for the filter over frames.

    Parameters
    ----------
    rig : StereoRig
        Geometry of the rectified pair.
    config : PipelineConfig, optional
        Parameters.
    workers : Workers, optional
        Threads to share with other pipelines; by default its own.

    Raises
    ------
    InputError
        If rig or parameters are of another type, or the camera's spectral response or flat field
        cannot be loaded.
    """

    def __init__(
        self, rig: StereoRig, config: PipelineConfig | None = None, workers: Workers | None = None
    ) -> None:
        self.rig = rig
        self.config = PipelineConfig() if config is None else config
        if not isinstance(rig, StereoRig):
            raise InputError(f"rig is a {type(rig).__name__}: give a StereoRig")
        if not isinstance(self.config, PipelineConfig):
            raise InputError(
                f"config is a {type(config).__name__}: give a PipelineConfig, as of "
                "PipelineConfig.from_parameters")
        self._workers = workers or Workers(self.config.threads)
        check_matcher(self.config.stereo, self._workers.threads)
        self._assessor = Assessor(self.config)
        self._estimators = Estimators(self.config, self._assessor, rig)
        centres = rig.principal_point, rig.principal_point_right or rig.principal_point
        self._flat_field = FlatFieldCorrection(self.config.camera, centres, self._workers)
        self._enhancement = ImageEnhancement(self.config, rig.range_error(), self._workers)
        self._by_lamps = (
            None if self._estimators.by_lamps is None
            else LampEnhancement(rig, self.config, self._workers))
        self._steps: tuple[FirstStep, SecondStep, Array | None] | None = None
        self._shape: tuple[int, int] | None = None
        self._lock = threading.Lock()

    def process(
        self, left: Image, right: Image, *, valid: Mask | None = None, match_original: bool = False,
        enhance: Collection[str] = SIDES, confidence: bool = True,
        colour: ChromaImage | None = None, known_light: LampLight | None = None,
        known_water: Callable[[], WaterEstimate | None] | None = None,
    ) -> FrameResult:
        """Assess and enhance one rectified pair.

        Parameters
        ----------
        left, right : ndarray
            ``(H, W, 3)`` RGB or ``(H, W)`` grey; uint8 or uint16.
        valid : ndarray, optional
            ``(H, W)`` bool, the pixels of the left image that show the scene;
            rectified images have empty borders.
        match_original : bool
            Whether to match the raw pair too, for comparison.
        enhance : collection of str
            Images to enhance: "left", "right". The estimates do not depend on it.
        confidence : bool
            Whether to rate the disparities.
        colour : ChromaImage, optional
            Colour of the left image at the native resolution of its JPEG or mosaic, for
            the estimate of the water; see `uw_visibility.images.chroma`.
        known_light : LampLight, optional
            Light of lamps and water from earlier frames (`WaterFilter.lamps`), with which
            images under lamps are restored, so that colours are stable over frames; by
            default that of this frame.
        known_water : callable, optional
            Returns the water from earlier frames as a `WaterEstimate`, ``known.at(stamp, rig)`` of
            `WaterFilter.known`, or None. It is called only if images are wanted and this frame, by
            daylight and not overexposed, does not show its water; the images are then restored
            with that of earlier frames, instead of left as they are.

        Returns
        -------
        FrameResult

        Raises
        ------
        InputError
            If the images do not fit, or show nothing that could be matched, if `valid` does
            not have their size, or if `enhance` has other names.
        """
        left, right = check_pair(left, right)
        valid = check_valid(valid, left.shape)
        if not isinstance(enhance, Collection) or any(side not in SIDES for side in enhance):
            raise InputError(
                f"enhance is {enhance!r}: give a tuple of the images wanted, of 'left' and 'right'")
        with self._lock:
            clock = StageClock()
            views = self._prepare(left, right, valid, colour, clock)
            first_step, second_step, light = self._steps_for(views.left.shape)
            coarse = first_step.run(views, clock)
            by_lamps = self._estimators.lit_by_lamps(coarse.water)
            if by_lamps:
                coarse = replace(coarse, lamps=light)
            views = with_codec_noise(views, coarse.points)
            improved = second_step.run(
                views, coarse, clock, match_original=match_original, confidence=confidence)
            filled, (water, visibility, restoring) = self._workers.together(
                lambda: self._fill(second_step, improved, enhance, clock),
                lambda: self._assess(coarse, improved, by_lamps, clock))
            with clock("image enhancement 2"):
                if by_lamps:
                    assert self._by_lamps is not None
                    images = self._by_lamps.run(
                        views, filled, known_light or water.lamps, coarse.right_gain, enhance)
                else:
                    assert restoring is not None
                    if known_water is not None and enhance:
                        restoring = _bridge(water, restoring, known_water)
                    images = self._enhancement.run(
                        views, filled, restoring, coarse.right_gain, enhance)
            low, high = disparity_limits(self.config.stereo, left.shape[1])
            return FrameResult(
                water=water,
                coarse_water=coarse.water,
                visibility=visibility,
                clear_water_attenuation=self._assessor.clear_water_attenuation,
                stereo=StereoResult(
                    disparity=improved.disparity, filled=filled.disparity,
                    range=filled.measured, filled_range=filled.left.range_map,
                    confidence=improved.confidence, original=improved.original,
                    support_points=len(coarse.points), coverage=coarse.coverage,
                    min_disparity=low, max_disparity=high, right_gain=coarse.right_gain),
                images=images,
                timing_ms=clock.milliseconds())

    def warm_up(
        self, shape: tuple[int, int], dtype: Any = np.uint8, *, grey: bool = False,
        compressed: bool = False,
    ) -> None:
        """Compile kernels and allocate memory for images of a height and width, px, and a type.

        `grey`: the images will be grey; `compressed`: they may be JPEG.
        """
        left, right = warm_up_pair(shape, np.dtype(dtype), grey=grey)
        self.process(left, right, match_original=True)
        # The texture counts as noise; matches without noise are rated differently.
        smooth = warm_up_pair(shape, np.dtype(dtype), grey=grey, smooth=True)
        self.process(*smooth, enhance=())
        if np.dtype(dtype) == np.uint8:
            # Reduced copies of noisy images have 16 bit.
            fine = warm_up_pair(shape, np.dtype(np.uint16), grey=grey)
            self.process(*fine, enhance=(), confidence=False)
        # A small pair shows too little to reach all kernels of the estimators.
        image, ranges = warm_up_scene(np.dstack((left,) * 3) if grey else left)
        if grey:
            if self._estimators.by_daylight is not None:
                plain = View.of(np.ascontiguousarray(image[..., 0]), self.config.camera.transfer)
                self._estimators.by_daylight.estimate_grey_view(plain, ranges, range_error=1e-3)
        else:
            view = View.of(check_pair(image, right)[0], self.config.camera.transfer)
            for estimator in (self._estimators.by_daylight, self._estimators.by_lamps):
                if estimator is not None:
                    estimator.estimate_view(view, ranges, range_error=1e-3)
            if self._by_lamps is not None:
                self._by_lamps.warm_up(view.pixels)
        if compressed:
            # Imported here, since losslessly compressed images do not need it.
            from uw_visibility.images.jpeg import warm_up_chroma

            self.process(left, right, enhance=(), confidence=False, colour=warm_up_chroma(left))

    def allocate(self, shape: tuple[int, int]) -> None:
        """Allocate memory for images of a height and width, px.

        Raises `InputError` if pairs of that size cannot be processed with these parameters.
        """
        with self._lock:
            self._flat_field.allocate(shape)
            self._steps_for(shape)

    def _prepare(
        self, left: Image, right: Image, valid: Mask | None, chroma: ChromaImage | None,
        clock: StageClock,
    ) -> StereoViews:
        """Even out the illumination, and measure the noise."""
        if self._flat_field.needed:
            with clock("even illumination"):
                left, right = self._flat_field.correct(left, right)
                chroma = self._flat_field.correct_chroma(chroma)
        transfer = self.config.camera.transfer
        return StereoViews(View.of(left, transfer, valid, chroma), View.of(right, transfer))

    def _steps_for(self, shape: tuple[int, int]) -> tuple[FirstStep, SecondStep, Array | None]:
        """Both steps for a size, and the direct light of lamps over range, if any."""
        if self._steps is None or self._shape != shape:
            self._steps = (
                FirstStep(shape, self.rig, self.config, self._estimators.first, self._workers),
                SecondStep(shape, self.rig, self.config, self._workers),
                self._estimators.light_by_range(shape))
            self._shape = shape
        return self._steps

    def _fill(
        self, step: SecondStep, improved: ImprovedDisparity, sides: Collection[str],
        clock: StageClock,
    ) -> FilledStereo:
        """Fill the gaps of the disparity, for both views; filled values are for colour only."""
        filled = np.full_like(improved.disparity, np.nan)
        if sides:
            with clock("interpolation"):
                filled = step.fill(improved)
        with clock("filled ranges"):
            return FilledStereo.of(
                self.rig, improved.disparity, filled, "right" in sides, self._workers)

    def _assess(
        self, coarse: CoarseEstimate, improved: ImprovedDisparity, by_lamps: bool,
        clock: StageClock,
    ) -> tuple[WaterEstimate, Visibility, RestorationWater | None]:
        """Estimate the water again, from the original pixels and the improved range; assess it.

        Also return the water with which images by daylight are restored.
        """
        with clock("visibility estimation 2"):
            # Pixels that the right view does not show are as good for the estimate.
            ranges = self.rig.range_from_disparity(improved.with_occlusions)
            water = self._estimate(coarse, improved, ranges)
            restoring = (
                None if by_lamps else self._restoration_water(water, coarse, improved, ranges))
        with clock("assessment"):
            return water, self._assessor.assess(water, by_lamps), restoring

    def _estimate(
        self, coarse: CoarseEstimate, improved: ImprovedDisparity, ranges: RangeMap
    ) -> WaterEstimate:
        if coarse.by_chance or improved.support_points < FEWEST_SUPPORT_POINTS:
            return WaterEstimate.not_assessable(Status.TOO_FEW_SUPPORT_POINTS)
        water = self._estimators.estimate(
            coarse.view, ranges, self.rig.range_error(improved.stddev), coarse.water)
        return compare_steps(coarse.water, water)

    def _restoration_water(
        self, water: WaterEstimate, coarse: CoarseEstimate, improved: ImprovedDisparity,
        measured: RangeMap,
    ) -> RestorationWater:
        """Water with which the images are restored.

        A channel that step 2 refuses is restored with the estimate of step 1, but stays refused. If
        both refuse a channel that has light, the image stays as it is: restoring the other channels
        would give a colour cast. A grey image has an estimate of its own, to restore its contrast.
        """
        first = coarse.water
        if coarse.view.colour is not None:
            missing = np.isnan(water.attenuation)
            if (water.refused_in_light & np.isnan(first.attenuation)).any():
                nothing = np.full(3, np.nan)
                return RestorationWater(nothing, nothing, nothing)
            return RestorationWater(
                np.where(missing, first.attenuation, water.attenuation),
                np.where(missing, first.ambient_light, water.ambient_light),
                np.where(missing, first.scene_light, water.scene_light),
                np.where(missing, first.ambient_light_stddev, water.ambient_light_stddev))
        assert self._estimators.by_daylight is not None
        found = self._estimators.by_daylight.estimate_grey_view(
            coarse.view, measured, range_error=self.rig.range_error(improved.stddev))
        attenuation, ambient_light = found or (np.nan, np.nan)
        light = np.array([ambient_light])
        return RestorationWater(np.array([attenuation]), light, light)


def _bridge(
    water: WaterEstimate, restoring: RestorationWater,
    known_water: Callable[[], WaterEstimate | None],
) -> RestorationWater:
    """Replace the water of a frame that does not show it by that of earlier frames.

    Excepted are frames that refute the model, as in the filter over frames, and overexposed ones,
    whose exposure differs from that of earlier veil and light.
    """
    unseen = water.refused_in_light
    if np.isfinite(restoring.attenuation).any() or not unseen.any():
        return restoring
    if water.status in REFUTING or Status.SATURATED in water.channel_status:
        return restoring
    known = known_water()
    # Restoring only some of the channels would give a colour cast.
    if known is None or np.isnan(known.attenuation[unseen]).any():
        return restoring
    return RestorationWater(
        known.attenuation, known.ambient_light, known.scene_light, known.ambient_light_stddev)
