# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Step 2 of Fig. 4: dense matching of the pair with its contrast restored.

Where noise leaves the coarse part of a scene only, it is matched on a small copy of the pair.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import DisparityMap, PerChannel, Points
from uw_visibility.images.view import StereoViews, View, code_value
from uw_visibility.optics.lamps import DirectLight
from uw_visibility.pipeline.first_step import CoarseEstimate, reduction_factor
from uw_visibility.pipeline.result import StageClock
from uw_visibility.stereo.airlight import Airlight, AirlightPrior
from uw_visibility.stereo.codec_noise import with_codec_noise
from uw_visibility.stereo.contrast import LUMA, ContrastNormalizer, least_noise_weights
from uw_visibility.stereo.denoising import ROUNDING
from uw_visibility.stereo.elas import DenseMatch, SupportPoints
from uw_visibility.stereo.interpolation import GapFiller, inpaint
from uw_visibility.stereo.matchers import MATCHER, MATCHERS, disparity_limits
from uw_visibility.stereo.noise_scale import matching_scale, shown
from uw_visibility.stereo.pyramid import Pyramid
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.stereo.views import in_right_view
from uw_visibility.water.estimate import WaterEstimate

# Confidence from which a match is more likely right than wrong.
_LIKELY = 0.5
# Disparities to search at a coarser scale, at least.
_FEWEST_DISPARITIES = 10


@dataclass(frozen=True)
class ImprovedDisparity:
    """Disparity matched in step 2.

    Attributes
    ----------
    disparity : ndarray
        ``(H, W)`` float32, left-referenced, px; NaN where unmatched.
    confidence : ndarray or None
        ``(H, W)`` float32, probability that `disparity` is within 1 px of the truth;
        0 where unmatched; None where not asked for.
    with_occlusions : ndarray
        ``(H, W)`` float32, `disparity` with what the right view does not show; see
        `DenseMatch`. Of a coarser scale than the finest, without matches that are more
        likely wrong than right.
    original : ndarray or None
        ``(H, W)`` float32, px; the raw pair matched alone, where asked for.
    match : DenseMatch
        Both views, at the size at which they were matched.
    support_points : int
        Support points of the restored pair.
    scale : int
        Side of the squares of pixels whose means were matched, px.
    """

    disparity: DisparityMap
    confidence: DisparityMap | None
    with_occlusions: DisparityMap
    original: DisparityMap | None
    match: DenseMatch
    support_points: int
    scale: int = 1


class _Scale:
    """Matcher of small copies of the images, reduced by `factor`; buffers preallocated."""

    def __init__(
        self, factor: int, shape: tuple[int, int], rig: StereoRig, config: PipelineConfig,
        workers: Workers,
    ) -> None:
        self.pyramid = Pyramid(factor, workers)
        self.factor = self.pyramid.factor(shape)
        stereo = self.pyramid.settings(config.stereo, shape)
        small = self.pyramid.shape(shape)
        limits = disparity_limits(stereo, small[1])
        self.matcher = MATCHERS[MATCHER](small, limits, stereo, workers)
        self.contrast = (
            ContrastNormalizer(small, self.factor), ContrastNormalizer(small, self.factor))
        self.airlight = Airlight(
            small, self.pyramid.rig(rig, shape), limits[1] + 2, config.camera.transfer, workers)
        self.gaps = GapFiller(small, config.enhancement.max_gap, workers)

    def downsample(self, views: StereoViews) -> StereoViews:
        """Return the pair at this scale."""
        return StereoViews(*(self.pyramid.downsample_view(view) for view in views))


class SecondStep:
    """Dense matching of the restored pair; buffers preallocated for one size of image.

    Those of a coarser scale, which noise may ask for, are allocated when it first does.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the images, px.
    rig : StereoRig
        Geometry of the pair.
    config : PipelineConfig
        Parameters, for images of this size.
    workers : Workers
        Threads.
    lamps : DirectLight, optional
        How the light of lamps falls with range, where they alone light the scene.

    Raises
    ------
    InputError
        If the limits of the disparity leave nothing to search.
    """

    def __init__(
        self, shape: tuple[int, int], rig: StereoRig, config: PipelineConfig, workers: Workers,
        lamps: DirectLight | None = None,
    ) -> None:
        self._shape = shape
        self._rig = rig
        self._config = config
        self._workers = workers
        self._lamps = lamps
        self._finest = self._new_scale(config.stereo.reduction)
        self._scales = {self._finest.factor: self._finest}
        # Noise may ask for one as coarse as step 1 has.
        self._sides = [self._finest.factor]
        side = 2 * self._finest.factor
        while Pyramid(side, workers).factor(shape) == side <= reduction_factor(shape, config):
            self._sides.append(side)
            side *= 2
        self._airlight_used = config.stereo.airlight_prior > 0

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
        views = with_codec_noise(views, coarse.points)
        scale = self._scale_for(views.left, coarse)
        rated = confidence or scale is not self._finest
        match, support = self._match(scale, views, coarse, clock, rated)
        found = self._upsample(scale, match, original, support, clock)
        if self._lamps is not None:
            found = self._with_darker(found, scale, views, coarse, clock)
        return found if confidence else replace(found, confidence=None)

    def fill(self, improved: ImprovedDisparity) -> DisparityMap:
        """Fill gaps of the left view's disparity, then large areas; at the images' size, px."""
        match = improved.match
        scale = self._scales[improved.scale]
        filled = inpaint(scale.gaps.fill(_whole(match), match.right), self._workers)
        return scale.pyramid.upsample_disparity(filled, self._shape)

    def coarse_disparity(self, left: View, right: View) -> DisparityMap:
        """Return the mesh of a raw pair's support points, at the images' size, px."""
        mesh = self._finest.matcher.coarse_disparity(self._raw_support(StereoViews(left, right)))
        return self._finest.pyramid.upsample_disparity(mesh, self._shape)

    def support_points(self, left: View, right: View) -> Points:
        """Return the support points of a raw pair, px of the images."""
        points = self._raw_support(StereoViews(left, right)).points
        return self._finest.pyramid.upsample_points(points, self._shape)

    def _raw_support(self, views: StereoViews) -> SupportPoints:
        scale = self._finest
        scale.matcher.describe_raw(scale.contrast, *scale.downsample(views))
        return scale.matcher.support_points()

    def _scale(self, factor: int) -> _Scale:
        """The scale of a factor, allocated when it is first asked for."""
        if factor not in self._scales:
            self._scales[factor] = self._new_scale(factor)
        return self._scales[factor]

    def _new_scale(self, factor: int) -> _Scale:
        return _Scale(factor, self._shape, self._rig, self._config, self._workers)

    def _scale_for(self, left: View, coarse: CoarseEstimate) -> _Scale:
        """The finest scale at which noise leaves most of what can be seen of the scene."""
        noise = _whole_noise(left)
        if len(self._sides) == 1 or np.max(noise) <= ROUNDING * code_value(left.pixels):
            return self._finest
        water, weights = coarse.water, np.array(LUMA)
        if self._lamps is None and _is_known(water):
            ranges = coarse.rig.range_from_disparity(coarse.disparity)
            weights = least_noise_weights(ranges, water.attenuation, water.ambient_light)
        factor = matching_scale(left.pixels, noise, weights, self._sides)
        return self._scale(factor)

    def _match(
        self, scale: _Scale, views: StereoViews, coarse: CoarseEstimate, clock: StageClock,
        confidence: bool,
    ) -> tuple[DenseMatch, int]:
        """Match the restored pair at a scale: the match, and the number of support points."""
        small = views
        if scale.factor > 1:
            with clock("reduction"):
                small = scale.downsample(views)
        with clock("image enhancement 1"):
            self._describe_restored(scale, small, coarse)
            points = scale.pyramid.downsample_points(coarse.points, self._shape)
            airlight = self._airlight_prior(scale, small.left, coarse, points)
        with clock("improved disparity"):
            support = scale.matcher.support_points(airlight, points)
            match = scale.matcher.dense_disparity(
                support, airlight, confidence=confidence,
                # So much noise leaves many wrong ones, which would tell of another water.
                least_for_colour=_LIKELY if confidence and scale is not self._finest else 0.0)
        return match, len(support)

    def _with_darker(
        self, found: ImprovedDisparity, scale: _Scale, views: StereoViews, coarse: CoarseEstimate,
        clock: StageClock,
    ) -> ImprovedDisparity:
        """Add ranges of what is too dark for a scale, and remove those of noise alone.

        The light of lamps falls so fast with range that no one scale suits near and far: what is
        not matched is matched at the next coarser scale, for the estimate of the water only.
        """
        coarser = self._coarser(scale)
        whole = found.with_occlusions
        if coarser is not None:
            with clock("darker disparity"):
                match, _ = self._match(coarser, views, coarse, StageClock(), False)
                darker = coarser.pyramid.upsample_disparity(_whole(match), self._shape)
            whole = np.where(np.isfinite(whole), whole, darker)
        left = views.left
        if left.colour is not None:
            seen = shown(left.pixels, _whole_noise(left), LUMA, 4 * scale.factor)
            whole = np.where(seen, whole, np.float32(np.nan))
        return replace(found, with_occlusions=whole)

    def _coarser(self, scale: _Scale) -> _Scale | None:
        """The next coarser scale; None where that leaves too few disparities."""
        factor = 2 * scale.factor
        low, high = disparity_limits(self._config.stereo, self._shape[1])
        if Pyramid(factor, self._workers).factor(self._shape) != factor:
            return None
        if (high - low) // factor < _FEWEST_DISPARITIES:
            return None
        return self._scale(factor)

    def _match_raw(self, views: StereoViews) -> DisparityMap:
        support = self._raw_support(views)
        found = self._finest.matcher.dense_disparity(support, confidence=False).disparity
        return self._finest.pyramid.upsample_disparity(found, self._shape)

    def _describe_restored(self, scale: _Scale, views: StereoViews, coarse: CoarseEstimate) -> None:
        """Describe the pair with its contrast restored; without an estimate as it is.

        Under lamps the known light is divided out, whatever the water is. By daylight channels that
        are too dark are left out; those refused for another reason still show the scene.
        """
        water, lamps = coarse.water, self._lamps
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
                    view.pixels, ranges, *lamps, self._workers, view.low_frequency_noise)
            scale.matcher.describe_view(side, scale.contrast[side])

        self._workers.together(
            lambda: describe(0, left, coarse.disparity, np.ones(3)),
            lambda: describe(
                1, right, in_right_view(coarse.disparity, self._workers), coarse.right_gain))

    def _airlight_prior(
        self, scale: _Scale, left: View, coarse: CoarseEstimate, points: Points
    ) -> AirlightPrior | None:
        """Bound ranges by the light that the water adds, as far as matches agree."""
        if left.colour is None or not self._airlight_used:
            return None
        return scale.airlight.prior(left.pixels, coarse.water, points, left.noise)

    def _upsample(
        self, scale: _Scale, match: DenseMatch, original: DisparityMap | None, support_points: int,
        clock: StageClock,
    ) -> ImprovedDisparity:
        """Bring what was matched to the size of the images."""
        disparity, confidence = match.disparity, match.confidence
        whole = _whole(match)
        if scale.factor > 1:
            with clock("full size"):
                disparity = scale.pyramid.upsample_disparity(disparity, self._shape)
                whole = scale.pyramid.upsample_disparity(whole, self._shape)
                if confidence is not None:
                    confidence = scale.pyramid.upsample_confidence(confidence, disparity)
        return ImprovedDisparity(
            disparity, confidence, whole, original, match, support_points, scale.factor)


def _is_known(water: WaterEstimate) -> bool:
    return bool(np.isfinite(water.attenuation).any() and not water.refused_in_light.any())


def _whole_noise(view: View) -> PerChannel:
    """Noise that the pixels show, and what a codec took of them, which is faint gradients first."""
    colour = view.colour
    if colour is None or not colour.codec_known:
        return view.noise
    codec = code_value(view.pixels) / code_value(colour.pixels) * colour.noise
    return np.asarray(np.maximum(view.noise, codec))


def _whole(match: DenseMatch) -> DisparityMap:
    return match.disparity if match.with_occlusions is None else match.with_occlusions
