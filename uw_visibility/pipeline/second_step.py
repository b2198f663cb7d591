# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Step 2 of Fig. 4: dense matching of the pair with its contrast restored.

If noise hides the fine detail of a scene, a reduced copy of the pair is matched.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import DisparityMap, PerChannel
from uw_visibility.images.network import ONNX
from uw_visibility.images.view import StereoViews, View, code_value
from uw_visibility.pipeline.first_step import CoarseEstimate, Scale, reduction_factor
from uw_visibility.pipeline.result import StageClock
from uw_visibility.stereo.contrast import LUMA, least_noise_weights
from uw_visibility.stereo.denoising import ROUNDING
from uw_visibility.stereo.elas import DenseMatch
from uw_visibility.stereo.interpolation import fill_gaps, inpaint
from uw_visibility.stereo.matchers import disparity_limits
from uw_visibility.stereo.noise_scale import matching_scale, shown
from uw_visibility.stereo.pyramid import Pyramid
from uw_visibility.stereo.rig import DISPARITY_STDDEV, StereoRig
from uw_visibility.stereo.views import in_right_view
from uw_visibility.water.estimate import WaterEstimate

# Confidence above which a match is more likely right than wrong.
_LIKELY = 0.5
# Least number of disparities to search at a coarser scale.
_FEWEST_DISPARITIES = 10


@dataclass(frozen=True)
class ImprovedDisparity:
    """Disparity matched in step 2."""

    disparity: DisparityMap  # ``(H, W)`` float32, left-referenced, px; NaN where unmatched
    # (H, W) float32 or None, probability that `disparity` is within 1 px of the truth; 0 where
    # unmatched; None if not wanted
    confidence: DisparityMap | None
    # ``(H, W)`` float32, `disparity` with pixels that the right view does not show; see
    # `DenseMatch`. At coarser scales, without matches that are more likely wrong than right.
    with_occlusions: DisparityMap
    # (H, W) float32 or None, px; disparity of the raw pair; None if not wanted
    original: DisparityMap | None
    match: DenseMatch  # at the size at which the views were matched
    support_points: int  # support points of the restored pair
    scale: int = 1  # factor by which the matched images were reduced

    @property
    def stddev(self) -> float:
        """Standard deviation of `disparity`, px; that of a network is found for each frame."""
        stddev = self.match.stddev
        return DISPARITY_STDDEV if stddev is None else stddev * self.scale


class SecondStep:
    """Dense matching of the restored pair; buffers preallocated for one size of image.

    Buffers of coarser scales, which noisy pairs need, are allocated at their first use.

    shape: height and width of the images, px.
    Raises `InputError` if the limits of the disparity leave nothing to search.
    """

    def __init__(
        self, shape: tuple[int, int], rig: StereoRig, config: PipelineConfig, workers: Workers,
    ) -> None:
        self._shape = shape
        self._rig = rig
        self._config = config
        self._workers = workers
        self._scales: dict[int, Scale] = {}
        self._finest = self._scale(Pyramid(config.stereo.reduction, shape).factor)
        # Factors of the scales that noisy pairs may need, up to that of step 1.
        self._sides = [self._finest.factor]
        # A network has the finest only: it was trained on noise, and a new size is slow.
        self._network = config.stereo.matcher == ONNX
        side = 2 * self._finest.factor
        while not self._network and (
            Pyramid(side, shape).factor == side <= reduction_factor(shape, config)
        ):
            self._sides.append(side)
            side *= 2

    def run(
        self, views: StereoViews, coarse: CoarseEstimate, clock: StageClock, *,
        match_original: bool = False, confidence: bool = True,
    ) -> ImprovedDisparity:
        """Match a pair densely, its contrast restored with the estimate of step 1.

        `match_original`: match the raw pair too; `confidence`: rate the disparities.
        """
        original = None
        if match_original:
            with clock("original disparity"):
                original = self._match_raw(views)
        scale = self._scale_for(views.left, coarse)
        rated = confidence or scale is not self._finest
        match, support = self._match(scale, views, coarse, clock, rated)
        found = self._upsample(scale, match, original, support, clock)
        if coarse.lamps is not None:
            found = self._with_darker(found, scale, views, coarse, clock)
        return found if confidence else replace(found, confidence=None)

    def fill(self, improved: ImprovedDisparity) -> DisparityMap:
        """Fill gaps of the left view's disparity, then large areas; at the images' size, px."""
        filled = fill_gaps(
            improved.match.with_occlusions, self._config.enhancement.max_gap, self._workers)
        return self._scales[improved.scale].pyramid.upsample_disparity(inpaint(filled))

    def _scale(self, factor: int) -> Scale:
        """The scale of a factor, allocated at its first use."""
        if factor not in self._scales:
            self._scales[factor] = Scale(
                factor, self._shape, self._rig, self._config, self._workers,
                self._config.stereo.matcher)
        return self._scales[factor]

    def _scale_for(self, left: View, coarse: CoarseEstimate) -> Scale:
        """The finest scale at which most of the visible scene is not hidden by noise."""
        noise = _whole_noise(left)
        if len(self._sides) == 1 or np.max(noise) <= ROUNDING * code_value(left.pixels):
            return self._finest
        water, weights = coarse.water, np.array(LUMA)
        if coarse.lamps is None and _is_known(water):
            ranges = coarse.rig.range_from_disparity(coarse.disparity)
            weights = least_noise_weights(ranges, water.attenuation, water.ambient_light)
        return self._scale(matching_scale(left.pixels, noise, weights, self._sides))

    def _match(
        self, scale: Scale, views: StereoViews, coarse: CoarseEstimate, clock: StageClock,
        confidence: bool,
    ) -> tuple[DenseMatch, int]:
        """Match the restored pair at a scale: the match, and the number of support points."""
        small = views
        if scale.factor > 1:
            with clock("reduction"):
                small = scale.downsample(views)
        with clock("image enhancement 1"):
            self._describe_restored(scale, small, coarse)
            points = scale.pyramid.downsample_points(coarse.points)
        with clock("improved disparity"):
            support = scale.matcher.support_points(points)
            match = scale.matcher.dense_disparity(
                support, confidence=confidence,
                # With this noise many matches are wrong, which would bias the water's estimate.
                least_for_colour=_LIKELY if confidence and scale is not self._finest else 0.0)
        return match, len(support)

    def _with_darker(
        self, found: ImprovedDisparity, scale: Scale, views: StereoViews, coarse: CoarseEstimate,
        clock: StageClock,
    ) -> ImprovedDisparity:
        """Add disparities of parts too dark for a scale, and remove those of noise alone.

        The light of lamps falls so fast with range that no single scale suits near and far:
        unmatched parts are matched at the next coarser scale, for the estimate of the water only.
        """
        coarser = self._coarser(scale)
        whole = found.with_occlusions
        if coarser is not None:
            with clock("darker disparity"):
                match, _ = self._match(coarser, views, coarse, StageClock(), False)
                darker = coarser.pyramid.upsample_disparity(match.with_occlusions)
            whole = np.where(np.isfinite(whole), whole, darker)
        left = views.left
        if left.colour is not None:
            seen = shown(left.pixels, _whole_noise(left), LUMA, 4 * scale.factor)
            whole = np.where(seen, whole, np.float32(np.nan))
        return replace(found, with_occlusions=whole)

    def _coarser(self, scale: Scale) -> Scale | None:
        """The next coarser scale; None if it has too few disparities, or with a network."""
        factor = 2 * scale.factor
        low, high = disparity_limits(self._config.stereo, self._shape[1])
        if self._network or Pyramid(factor, self._shape).factor != factor:
            return None
        if (high - low) // factor < _FEWEST_DISPARITIES:
            return None
        return self._scale(factor)

    def _match_raw(self, views: StereoViews) -> DisparityMap:
        scale = self._finest
        scale.matcher.describe_raw(scale.contrast, *scale.downsample(views))
        support = scale.matcher.support_points()
        found = scale.matcher.dense_disparity(support, confidence=False).disparity
        return scale.pyramid.upsample_disparity(found)

    def _describe_restored(self, scale: Scale, views: StereoViews, coarse: CoarseEstimate) -> None:
        """Describe the pair with its contrast restored, or the raw pair without an estimate.

        Under lamps the known light is divided out, without an estimate. By daylight, channels too
        dark are left out; if others are refused, which still show the scene, the pair stays raw.
        """
        water, lamps = coarse.water, coarse.lamps
        left, right = views
        if left.colour is None or (lamps is None and not _is_known(water)):
            scale.matcher.describe_raw(scale.contrast, left, right)
            return

        def describe(side: int, view: View, disparity: DisparityMap, gain: PerChannel) -> None:
            ranges = coarse.rig.range_from_disparity(disparity)
            if lamps is None:
                scale.contrast[side].restore(
                    view.pixels, ranges, water.attenuation, gain * water.ambient_light,
                    self._workers, view.low_frequency_noise)
            else:
                scale.contrast[side].restore_lit(
                    view.pixels, ranges, lamps, self._workers, view.low_frequency_noise)
            scale.matcher.describe_view(side, scale.contrast[side])

        self._workers.together(
            lambda: describe(0, left, coarse.disparity, np.ones(3)),
            lambda: describe(
                1, right, in_right_view(coarse.disparity, self._workers), coarse.right_gain))

    def _upsample(
        self, scale: Scale, match: DenseMatch, original: DisparityMap | None, support_points: int,
        clock: StageClock,
    ) -> ImprovedDisparity:
        """Upsample a match to the size of the images."""
        disparity, confidence, whole = match.disparity, match.confidence, match.with_occlusions
        if scale.factor > 1:
            with clock("full size"):
                disparity, whole = map(scale.pyramid.upsample_disparity, (disparity, whole))
                least, _ = disparity_limits(self._config.stereo, self._shape[1])
                for found in (disparity, whole):
                    found[found < least] = np.nan
                if confidence is not None:
                    confidence = scale.pyramid.upsample_confidence(confidence, disparity)
        return ImprovedDisparity(
            disparity, confidence, whole, original, match, support_points, scale.factor)


def _is_known(water: WaterEstimate) -> bool:
    return bool(np.isfinite(water.attenuation).any() and not water.refused_in_light.any())


def _whole_noise(view: View) -> PerChannel:
    """Noise of the pixels, or that of the codec if larger: it removes faint gradients first."""
    colour = view.colour
    if colour is None or not colour.codec_known:
        return view.noise
    codec = code_value(view.pixels) / code_value(colour.pixels) * colour.noise
    return np.asarray(np.maximum(view.noise, codec))
