# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""How well attenuation is told where the paper's one light holds: `water.veil: paper`.

    python -m uw_visibility_lab.posterior.one_light POOL

draws one view of each scene of a pool (`worlds pool`) by the paper's model, with measured ranges,
and prints the errors of mean attenuation and of the distance, and their scores.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import numpy as np

from uw_visibility.config.schema import PipelineConfig, WaterConfig
from uw_visibility.status import Status
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility_lab.evaluation.degrade import degrade
from uw_visibility_lab.worlds import scenes
from uw_visibility_lab.worlds.ranging import measure_ranges

SEED = 5
PARTICLES = (0.02, 0.6)
"""Mean attenuation by particles, 1/m, log-uniform."""
DEPTHS = (1.0, 20.0)
NOISE = (0, 0, 1, 2)
"""Deviation of noise, in 8-bit code values."""
RANGE_EFFECTS = ("disparity noise", "occlusion", "unmatched", "wrong patches")
LEAST_CODE = 40
"""Images that are darker everywhere are not drawn."""


def main(arguments: list[str] | None = None) -> int:
    """Print the errors over the scenes of a pool."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pool", type=Path)
    options = parser.parse_args(arguments)
    assessor = Assessor(PipelineConfig())
    clear = assessor.clear_water_attenuation
    estimator = WaterEstimator(WaterConfig(veil="paper"), clear, daylight=assessor.daylight)
    drawn, found = 0, []
    for number, path in enumerate(scenes.pool(options.pool)):
        rng = np.random.default_rng([SEED, number])
        scene = scenes.load_scene(path)
        alpha = float(np.exp(rng.uniform(*np.log(PARTICLES))))
        far = np.where(np.isfinite(scene.range), scene.range, np.float32(1e4))
        image = degrade(
            np.clip(scene.reflectance * 255, 0, 255), far, alpha, rng.uniform(*DEPTHS), clear)
        noise = rng.normal(0, rng.choice(NOISE), image.shape)
        image = np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)
        if image.max() < LEAST_CODE:
            continue
        drawn += 1
        streams = partial(_stream, number)
        ranges, error = measure_ranges(streams, scene.range, image, RANGE_EFFECTS)
        estimate = estimator.estimate(image, ranges, range_error=error)
        if estimate.status is Status.OK:
            covariance = estimate.covariance[0::2, 0::2]
            off = float(np.nanmean(estimate.attenuation - clear)) - alpha
            nearest = int(np.nanargmin(estimate.attenuation))
            beta = float(estimate.attenuation[nearest])
            longer = float(np.log((clear + alpha).min() / beta))
            found.append((
                off, off / float(np.sqrt(np.nansum(covariance)) / 3.0), longer,
                longer * beta / float(np.sqrt(covariance[nearest, nearest]))))
    values = np.array(found).reshape(-1, 4).T
    error, score = np.abs(values[:2])
    _, of_score, of_distance, of_its_score = np.sqrt((values**2).mean(axis=1))
    print(
        f"{len(found)} of {drawn} views told; |error of alpha| {error.mean():.4f} 1/m, worst "
        f"{error.max():.3f}, rms of its scores {of_score:.2f}, {int((score > 3).sum())} beyond 3; "
        f"ln distance off by {of_distance:.2f} (rms), scores {of_its_score:.2f}")
    return 0


def _stream(number: int, purpose: str) -> np.random.Generator:
    return np.random.default_rng([SEED, number, *purpose.encode()])


if __name__ == "__main__":
    raise SystemExit(main())
