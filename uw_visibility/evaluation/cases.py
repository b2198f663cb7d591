# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""One case: a scene in one water, by the pipeline, by peers, and by the oracle.

A case is one point of section III of the paper. On the same 8-bit pixels stand side
by side: the degraded input, OpenCV's peers, the pipeline, and the oracle, which
restores with the true water and range.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.radiance import recover_radiance
from uw_visibility.enhancement.white_balance import RestorationWater
from uw_visibility.errors import InputError
from uw_visibility.evaluation import baselines, metrics
from uw_visibility.evaluation.degrade import Scene, fill_from_background, sensor_of
from uw_visibility.evaluation.depth_edges import EdgeErrors, edge_errors
from uw_visibility.evaluation.methods import of_kind, titles
from uw_visibility.evaluation.partial_pipeline import first_enhancement, match_with_truth
from uw_visibility.evaluation.readings import Reader, Reading, Truth, flat
from uw_visibility.evaluation.reliability import Reliability
from uw_visibility.evaluation.scenes import SceneSource, search_limit, tolerance
from uw_visibility.images.arrays import Image8, Map
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.water.observations import Envelopes

READINGS = titles("estimator", {
    "step1": "ours after step 1, ranges of the pipeline",
    "pipeline": "ours, ranges of the pipeline",
    "exact": "ours, exact ranges",
    "paper_pipeline": "plain method, ranges of the pipeline",
    "paper_exact": "plain method, exact ranges",
})
"""Estimates of the water, by their names in tables; the plain method is the paper's own fit."""

MATCHES = titles("matcher", {
    "sgbm": "SGBM, raw pair",
    "clahe_sgbm": "SGBM after CLAHE",
    "oracle_sgbm": "SGBM after the oracle",
    "ours_raw": "ours, raw pair",
    "ours": "ours, enhanced pair",
    "oracle_ours": "ours, true water and ranges",
})
"""Disparity maps, by their names in tables."""

IMAGES = titles("restorer", {
    "degraded": "degraded input",
    "histogram": "histogram equalisation",
    "clahe": "CLAHE",
    "step1": "ours after step 1",
    "final": "ours after step 2",
    "oracle": "oracle",
})
"""Images that are held against the scene in air, by their names in tables."""


THUMBNAIL_WIDTH = 240


@dataclass(frozen=True)
class Case:
    """A scene and the water to put it in.

    Attributes
    ----------
    source : SceneSource
        The scene.
    mean_attenuation : float
        α, 1/m.
    depth : float
        z, m.
    pictures : bool
        Whether images and observations are wanted too, for figures.
    noise : str
        Noise of the sensor, see `sensor_of`.
    """

    source: SceneSource
    mean_attenuation: float
    depth: float
    pictures: bool = False
    noise: str = "0"
    thumbnails: bool = False


@dataclass(frozen=True)
class Pictures:
    """Images and envelopes of a case, for figures 3, 5 and 9.

    Attributes
    ----------
    radiance : (H, W, 3) uint8 ndarray
        The scene in air.
    images : dict of str to ndarray
        Those of `IMAGES`; ours are absent where the pair was refused.
    range : (H, W) float32 ndarray
        True range, m; NaN where unknown.
    envelope : Envelopes or None
        What the estimate of step 2 rests on.
    disparities : dict of str to ndarray
        Ours, of the pair as it is and improved, px; absent where the pair was refused.
    """

    radiance: Image8
    images: dict[str, Image8]
    range: Map
    envelope: Envelopes | None
    disparities: dict[str, Map]


@dataclass(frozen=True)
class CaseResult:
    """Measurements of a case.

    Attributes
    ----------
    scene : str
        Name of the scene.
    truth : Truth
        The water.
    tolerance : float
        Largest error of a correct disparity, px.
    refusal : str or None
        Why the pipeline refused the pair as a whole, if it did.
    readings : dict of str to Reading
        By the names of `READINGS`.
    matched, correct : dict of str to float
        Share of all pixels that have a disparity, and of the pixels with known
        truth that have a correct one, by the names of `MATCHES`. A refused
        pair has no disparities: 0.
    wrong : dict of str to float
        Share of the matched pixels with known truth that have a wrong disparity, by
        the names of `MATCHES`; NaN where nothing is matched.
    colour_difference : dict of str to float
        Mean ΔE*ab over the image, by the names of `IMAGES`; NaN where refused.
    pictures : Pictures or None
        Where the case asked for them.
    edges : list of EdgeErrors
        Errors beside depth edges, where the case asked for pictures and the pair
        was not refused.
    noise : str
        Noise of the sensor.
    reliability : Reliability or None
        Of our confidence; None where the pair was refused.
    thumbnails : dict of str to ndarray
        Small images under water and enhanced, where the case asked for them.
    timing_ms : dict of str to float
        Durations of the pipeline's stages; empty where the pair was refused.
    """

    scene: str
    truth: Truth
    tolerance: float
    refusal: str | None
    readings: dict[str, Reading]
    matched: dict[str, float]
    correct: dict[str, float]
    wrong: dict[str, float]
    colour_difference: dict[str, float]
    pictures: Pictures | None = None
    edges: list[EdgeErrors] = field(default_factory=list)
    noise: str = "0"
    reliability: Reliability | None = None
    thumbnails: dict[str, Image8] = field(default_factory=dict)
    timing_ms: dict[str, float] = field(default_factory=dict)

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

    Parameters
    ----------
    case : Case
        The scene and the water.
    config : PipelineConfig
        Parameters of the pipeline. Where `stereo.max_disparity` is 0, all
        matchers search up to the scene's `search_limit`.

    Raises
    ------
    InputError
        If the scene cannot be loaded.
    """
    scene = case.source.load()
    bench = _bench(case.source, config)
    kappa = bench.reader.assessor.clear_water_attenuation
    truth = Truth.of_clear_water_and_particles(
        case.mean_attenuation, case.depth, kappa, config.assessment.contrast
    )
    left, right = scene.degraded(
        case.mean_attenuation, case.depth, kappa, sensor_of(case.noise))
    images, oracle_right = _peer_images(scene, left, right, truth)
    refusal = result = None
    try:
        result = bench.pipeline.process(left, right, match_original=True)
    except InputError as error:
        # A pair that the pipeline refuses is a result too.
        refusal = f"pair refused: {error}"
    if result is not None:
        images["step1"] = first_enhancement(left, right, bench.pipeline)
        images["final"] = result.left_enhanced
    ranges = np.full(left.shape[:2], np.nan, np.float32) if result is None else result.range
    for name, own in of_kind("restorer").items():
        images[name] = own.image(left, ranges, dtype=np.uint8)
    disparities = _peer_matches(left, right, images["oracle"], oracle_right, bench.disparities)
    if result is not None:
        disparities["ours_raw"] = result.stereo.original
        disparities["ours"] = result.disparity
    for name, own in of_kind("matcher").items():
        disparities[name] = own.image(left, right, bench.disparities - 1, dtype=np.float32)
    disparities["oracle_ours"] = match_with_truth(
        left, right, fill_from_background(scene.disparity_left), truth, bench.rig, bench.config)
    readings = bench.read(left, result, refusal)
    known = scene.disparity_left, tolerance(scene)
    return CaseResult(
        scene=scene.name,
        truth=truth,
        tolerance=tolerance(scene),
        refusal=refusal,
        readings=readings,
        matched=_shares(disparities, metrics.matched_fraction),
        correct=_shares(disparities, metrics.correct_fraction, *known),
        wrong=_shares(disparities, metrics.bad_fraction, *known, absent=float("nan")),
        colour_difference={
            name: metrics.mean_colour_difference(images[name], scene.left)
            if name in images else float("nan")
            for name in IMAGES
        },
        pictures=None if not case.pictures else Pictures(
            scene.left, {name: images[name] for name in IMAGES if name in images},
            bench.exact_range, None if result is None else result.water.envelope,
            {name: found for name in ("ours_raw", "ours")
             if (found := disparities.get(name)) is not None},
        ),
        thumbnails={} if not case.thumbnails else {
            name: _thumbnail(images[name]) for name in ("degraded", "final") if name in images},
        timing_ms={} if result is None else dict(result.timing_ms),
        edges=[] if result is None or not case.pictures else edge_errors(
            scene, left, right, result, bench.rig, bench.config),
        noise=case.noise,
        reliability=None if result is None or result.stereo.confidence is None else Reliability.of(
            result.disparity, result.stereo.confidence, *known),
    )


class _Bench:
    """Rig, pipeline and estimators that serve all cases of a scene."""

    def __init__(self, scene: Scene, config: PipelineConfig) -> None:
        self.disparities = config.stereo.max_disparity + 1
        if config.stereo.max_disparity == 0:
            self.disparities = search_limit(scene)
        stereo = replace(config.stereo, max_disparity=self.disparities - 1)
        self.config = replace(config, stereo=stereo)
        self.rig = scene.rig
        self.pipeline = Pipeline(self.rig, self.config)
        self.exact_range = scene.rig.range_from_disparity(scene.disparity_left)
        self.reader = Reader(config)

    def read(
        self, left: Image8, result: FrameResult | None, refusal: str | None
    ) -> dict[str, Reading]:
        """Estimate the water by both methods, with the pipeline's ranges and with the true ones."""
        reader = self.reader
        readings = {
            "exact": reader.estimate(left, self.exact_range),
            "paper_exact": reader.estimate(left, self.exact_range, "paper"),
        }
        if result is None:
            refused = Reading.refused(refusal or "")
            readings |= dict.fromkeys(("step1", "pipeline", "paper_pipeline"), refused)
        else:
            found = self.rig.range_from_disparity(result.disparity)
            readings["step1"] = reader.read(result.coarse_water)
            readings["pipeline"] = Reading.of_result(result)
            readings["paper_pipeline"] = reader.estimate(left, found, "paper")
        for name, own in of_kind("estimator").items():
            found = self.exact_range if result is None else result.range
            readings[name] = reader.read(own.run(left, found, self.config.camera.transfer))
        return {name: readings[name] for name in READINGS}


@lru_cache(maxsize=1)
def _bench(source: SceneSource, config: PipelineConfig) -> _Bench:
    return _Bench(source.load(), config)


def _thumbnail(image: Image8) -> Image8:
    height, width = image.shape[:2]
    size = (THUMBNAIL_WIDTH, round(THUMBNAIL_WIDTH * height / width))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def _peer_images(
    scene: Scene, left: Image8, right: Image8, truth: Truth
) -> tuple[dict[str, Image8], Image8]:
    """Return the left images that need no estimate, and the oracle's right one."""
    oracle_left, oracle_right = (
        _oracle(image, scene.rig.range_from_disparity(fill_from_background(disparity)), truth)
        for image, disparity in ((left, scene.disparity_left), (right, scene.disparity_right))
    )
    images = {
        "degraded": left,
        "histogram": baselines.equalise_channels(left),
        "clahe": baselines.equalise_adaptively(left),
        "oracle": oracle_left,
    }
    return images, oracle_right


def _oracle(image: Image8, range_map: Map, truth: Truth) -> Image8:
    """Restore an image with the true water and range, without limit of the gain (eq. 8)."""
    light = np.array(truth.ambient_light)
    water = RestorationWater(np.array(truth.attenuation), light, light)
    radiance = recover_radiance(image, range_map, water)
    return np.asarray(np.clip(radiance * 255 + 0.5, 0, 255), dtype=np.uint8)


def _peer_matches(
    left: Image8, right: Image8, oracle_left: Image8, oracle_right: Image8, disparities: int
) -> dict[str, Map | None]:
    match = baselines.semi_global_matching
    return {
        "sgbm": match(left, right, disparities),
        "clahe_sgbm": baselines.equalised_matching(left, right, disparities),
        "oracle_sgbm": match(oracle_left, oracle_right, disparities),
    }


def _shares(
    disparities: Mapping[str, Map | None], measure: Callable[..., float], *known: Any,
    absent: float = 0.0,
) -> dict[str, float]:
    """Measure the disparity map of each method; that of a pair that was refused is absent."""
    found = {name: disparities.get(name) for name in MATCHES}
    return {
        name: absent if disparity is None else measure(disparity, *known)
        for name, disparity in found.items()
    }
