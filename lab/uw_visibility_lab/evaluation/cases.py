# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""One case: a scene in one water, by the pipeline, by OpenCV's methods, and by the oracle.

A case is one point of section III of the paper. All methods process the same 8-bit
pixels, which are compared, too, as the degraded input. The oracle restores with the
true water and range.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.radiance import RestorationWater, Restorer
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Image8, Map, RangeMap
from uw_visibility.images.view import StereoViews, View
from uw_visibility.optics.light_model import contrast_gain, radiance_of, transmission
from uw_visibility.optics.transfer import from_linear, to_linear
from uw_visibility.pipeline.first_step import FirstStep
from uw_visibility.pipeline.lamps import Estimators
from uw_visibility.pipeline.parts import estimate_water
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import StageClock
from uw_visibility.stereo.pyramid import Pyramid
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility.water.observations import Envelopes
from uw_visibility_lab.evaluation import baselines, metrics
from uw_visibility_lab.evaluation.degrade import QUIET, fill_from_background, sensor_of
from uw_visibility_lab.evaluation.fits import fit_plain
from uw_visibility_lab.evaluation.readings import Reading, Truth
from uw_visibility_lab.evaluation.scenes import Source, load_source, search_limit, tolerance
from uw_visibility_lab.evaluation.tables import flat

READINGS = {
    "step1": "ours after step 1",
    "pipeline": "ours",
    "exact": "ours, exact ranges",
    "paper_pipeline": "plain fit",
    "paper_exact": "plain fit, exact ranges",
}
"""Estimates of the water, by their names in tables; the plain fit is the paper's own."""

MATCHES = {
    "sgbm": "SGBM, raw pair",
    "clahe_sgbm": "SGBM after CLAHE",
    "oracle_sgbm": "SGBM after the oracle",
    "ours_raw": "ours, raw pair",
    "ours": "ours, enhanced pair",
}
"""Disparity maps, by their names in tables."""

IMAGES = {
    "degraded": "degraded input",
    "histogram": "histogram equalisation",
    "clahe": "CLAHE",
    "step1": "ours after step 1",
    "final": "ours after step 2",
    "oracle": "oracle",
}
"""Images that are compared with the scene in air, by their names in tables."""

THUMBNAIL_WIDTH = 240


@dataclass(frozen=True)
class Case:
    """A scene and its water."""

    source: Source  # the scene
    mean_attenuation: float  # α, 1/m
    depth: float  # z, m
    pictures: bool = False  # whether to return images and envelopes, too, for figures
    noise: str = QUIET  # noise of the sensor, see `sensor_of`
    thumbnails: bool = False


@dataclass(frozen=True)
class Pictures:
    """Images and envelopes of a case, for figures 3, 5 and 9."""

    radiance: Image8  # (H, W, 3); the scene in air
    images: dict[str, Image8]  # those of `IMAGES`; without ours if the pair was refused
    range: Map  # (H, W); true range, m; NaN where unknown
    envelope: Envelopes | None  # observations of the estimate of step 2
    # ours, of the raw and of the enhanced pair, px; empty if the pair was refused
    disparities: dict[str, Map]


@dataclass(frozen=True)
class CaseResult:
    """Measurements of a case."""

    scene: str  # name of the scene
    truth: Truth  # the water
    tolerance: float  # largest error of a correct disparity, px
    refusal: str | None  # why the pipeline refused the pair as a whole, if it did
    readings: dict[str, Reading]  # by the names of `READINGS`
    # matched, correct: share of all pixels that have a disparity, and of the pixels with known
    # truth that have a correct one, by the names of `MATCHES`. A refused pair has no disparities: 0
    matched: dict[str, float]
    correct: dict[str, float]
    # share of the matched pixels with known truth that have a wrong disparity, by the names of
    # `MATCHES`; NaN where nothing is matched
    wrong: dict[str, float]
    # mean ΔE*ab over the image, by the names of `IMAGES`; NaN where refused
    colour_difference: dict[str, float]
    pictures: Pictures | None = None  # if the case asks for them
    noise: str = QUIET  # noise of the sensor
    # counts of `metrics.reliability` of our confidence; None if the pair was refused
    reliability: Array | None = None
    # small images under water and enhanced, if the case asks for them
    thumbnails: dict[str, Image8] = field(default_factory=dict)

    def row(self) -> dict[str, Any]:
        """Return the case as a row of a table."""
        return flat({
            "scene": self.scene, "noise": self.noise, "true": self.truth,
            "tolerance": self.tolerance, "refusal": self.refusal, **self.readings,
            "matched": self.matched, "correct": self.correct, "wrong": self.wrong,
            "colour_difference": self.colour_difference,
        })


def evaluate_case(case: Case, config: PipelineConfig) -> CaseResult:
    """Simulate a scene under water and measure everything that the experiments need.

    If `stereo.max_disparity` is 0, all matchers search up to the scene's `search_limit`.
    """
    scene, (pipeline, assessor) = load_source(case.source), _prepared(case.source, config)
    config, kappa = pipeline.config, assessor.clear_water_attenuation
    beta = kappa + case.mean_attenuation
    truth = Truth.of_water(
        beta, transmission(beta, case.depth), kappa, case.depth,
        config.assessment.contrast)
    left, right = scene.degraded(
        case.mean_attenuation, case.depth, kappa, sensor_of(case.noise))
    filled = [fill_from_background(d) for d in (scene.disparity_left, scene.disparity_right)]
    oracle_left, oracle_right = (
        _oracle(image, scene.rig.range_from_disparity(disparity), truth)
        for image, disparity in zip((left, right), filled, strict=True)
    )
    images = {
        "degraded": left,
        "histogram": baselines.equalise_channels(left),
        "clahe": baselines.equalise_adaptively(left),
        "oracle": oracle_left,
    }
    nothing = np.full(left.shape[:2], np.nan, np.float32)
    count = config.stereo.max_disparity + 1
    disparities = {
        "sgbm": baselines.semi_global_matching(left, right, count),
        "clahe_sgbm": baselines.equalised_matching(left, right, count),
        "oracle_sgbm": baselines.semi_global_matching(oracle_left, oracle_right, count),
        "ours_raw": nothing, "ours": nothing,
    }
    exact_range = scene.rig.range_from_disparity(scene.disparity_left)

    def read(water: WaterEstimate) -> Reading:
        return Reading.of(water, assessor.assess(water))

    def read_plain(ranges: RangeMap) -> Reading:
        return read(fit_plain(left, ranges, kappa, config.camera.transfer))

    exact = estimate_water(
        left, scene.disparity_left, scene.rig, config, disparity_stddev=0.0)
    readings = {
        "exact": Reading.of(exact.water, exact.visibility), "paper_exact": read_plain(exact_range)}
    refusal = result = None
    try:
        result = pipeline.process(left, right, match_original=True)
    except InputError as error:
        # A pair that the pipeline refuses is a result, too.
        refusal = f"pair refused: {error}"
        readings |= dict.fromkeys(
            ("step1", "pipeline", "paper_pipeline"), Reading.refused(refusal))
    if result is not None:
        images["step1"] = first_enhancement(left, right, pipeline)
        images["final"] = result.left_enhanced
        assert result.stereo.original is not None
        disparities |= {"ours_raw": result.stereo.original, "ours": result.disparity}
        readings["step1"] = read(result.coarse_water)
        readings["pipeline"] = Reading.of(result.water, result.visibility)
        readings["paper_pipeline"] = read_plain(scene.rig.range_from_disparity(result.disparity))
    known = scene.disparity_left, tolerance(scene)
    return CaseResult(
        scene=scene.name,
        truth=truth,
        tolerance=tolerance(scene),
        refusal=refusal,
        readings={name: readings[name] for name in READINGS},
        matched={name: metrics.matched_fraction(disparities[name]) for name in MATCHES},
        correct={name: metrics.correct_fraction(disparities[name], *known) for name in MATCHES},
        wrong={name: metrics.bad_fraction(disparities[name], *known) for name in MATCHES},
        colour_difference={
            name: float(metrics.colour_difference(images[name], scene.left).mean())
            if name in images else float("nan")
            for name in IMAGES
        },
        pictures=None if not case.pictures else Pictures(
            scene.left, images, exact_range, None if result is None else result.water.envelope,
            {} if result is None else {name: disparities[name] for name in ("ours_raw", "ours")},
        ),
        thumbnails={} if not case.thumbnails else {
            name: _thumbnail(images[name]) for name in ("degraded", "final") if name in images},
        noise=case.noise,
        reliability=None if result is None or result.stereo.confidence is None else (
            metrics.reliability(result.disparity, result.stereo.confidence, *known)),
    )


@lru_cache(maxsize=1)
def _prepared(source: Source, config: PipelineConfig) -> tuple[Pipeline, Assessor]:
    """Return the pipeline for all cases of a scene, and the assessor for other estimates."""
    scene = load_source(source)
    largest = config.stereo.max_disparity or search_limit(scene) - 1
    stereo = replace(config.stereo, max_disparity=largest)
    config = replace(config, stereo=stereo)
    return Pipeline(scene.rig, config), Assessor(config)


def _thumbnail(image: Image8) -> Image8:
    height, width = image.shape[:2]
    size = (THUMBNAIL_WIDTH, round(THUMBNAIL_WIDTH * height / width))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def first_enhancement(
    left: NDArray[Any],
    right: NDArray[Any],
    pipeline: Pipeline,
) -> NDArray[Any]:
    """Restore the left image with the coarse map of step 1 and its estimate of the water.

    The pipeline itself needs the contrast of step 1 only; Fig. 7 of the paper shows its colours.
    """
    config, rig = pipeline.config, pipeline.rig
    transfer, shape, workers = config.camera.transfer, left.shape[:2], Workers(config.threads)
    estimator = Estimators(config, Assessor(config), rig).first
    first = FirstStep(shape, rig, config, estimator, workers).run(
        StereoViews(View.of(left, transfer), View.of(right, transfer)), StageClock())
    pyramid = Pyramid(shape[1] // first.disparity.shape[1], shape)
    ranges = rig.range_from_disparity(pyramid.upsample_disparity(first.disparity))
    water = RestorationWater(
        first.water.attenuation, first.water.ambient_light, first.water.scene_light)
    enhanced, _ = Restorer(config.enhancement, transfer, workers).restore(left, ranges, water)
    return np.asarray(enhanced)


def _oracle(image: Image8, range_map: Map, truth: Truth) -> Image8:
    """Restore an image with the true water and range, without a limit of the gain (eq. 8)."""
    light = np.array(truth.ambient_light)
    gain = contrast_gain(np.array(truth.attenuation), range_map[..., np.newaxis])
    irradiance = to_linear(image, "linear").astype(np.float64)
    radiance = radiance_of(irradiance, gain, light, light).astype(np.float32)
    return np.asarray(from_linear(radiance, "linear", np.uint8), np.uint8)
