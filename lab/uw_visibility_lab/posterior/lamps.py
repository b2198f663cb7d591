# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit the numbers of the posterior under lamps, `uw_visibility.water.lamps.posterior.FITTED`.

python -m uw_visibility_lab.posterior.lamps POOL [CASES]
prints those of the greatest likelihood over nights of three kinds, by coordinate ascent. First it
prints how much albedo of scattering over reflectance differs between channels, `OF_CHANNELS`.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from uw_visibility.compute.processes import process_pool
from uw_visibility.compute.threads import Workers, use_one_thread
from uw_visibility.config.lighting import LightingConfig
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import Array
from uw_visibility.images.cells import means
from uw_visibility.water.lamps.nodes import Nodes
from uw_visibility.water.lamps.posterior import FITTED, Fitted, infer
from uw_visibility_lab.posterior.cases import by_lamps
from uw_visibility_lab.posterior.judge import LampCase, estimate_by_lamps
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.frame import Renderer
from uw_visibility_lab.simulation.lamps import Lighting, default_rig, lighting_parameters
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.water import CLEAR_WATER, Water
from uw_visibility_lab.worlds.beliefs import draw
from uw_visibility_lab.worlds.draw import Streams, vary
from uw_visibility_lab.worlds.scenes import Scene, load_scene
from uw_visibility_lab.worlds.scenes import pool as scenes_of

CASES = 80
# Scenes that are used of a pool.
SCENES = 400
# Camera and depth (m) of the reefs: so deep that there is no daylight, as in the frames.
CAMERA, DEPTH = StereoCamera(480, 360, 450.0, 0.12), 40.0
# Seed of nights, and first seed of reefs: others than those of the command `judge`.
SEED, REEFS = 11, 1000
# Exponent of reflectance relative to its median: ground as even as sand and rock.
EVEN = 0.35
# Patches across a scene, and what is added to reflectance before the logarithm.
PATCHES, BLACK = 20, 1e-4
# Factor of a number's steps, least gain of mean ln likelihood by a step, and rounds of all numbers.
STEP, GAIN, ROUNDS = 1.5, 0.005, 2
# Errors are limited to this number of deviations, so that wrong nights do not dominate.
WRONG = 5.0


class Night(NamedTuple):
    """Nodes of a night, the declared parameters, and the true attenuation."""

    nodes: Nodes
    lighting: LightingConfig
    clear_water: Array
    attenuation: Array


def reefs(number: int, first: int = REEFS) -> Iterator[LampCase]:
    """Reefs of the simulation under two and four lamps, true ranges; `first` is a seed."""
    for index in range(number):
        rng = np.random.default_rng((SEED, index))
        lamps = default_rig(2 if index % 2 else 4)
        seed = first + index
        lighting = Lighting(lamps, daylight=False, shaded=index % 4 < 2)
        water = Water(math.exp(rng.uniform(math.log(0.05), math.log(0.4))), DEPTH)
        frame = Renderer(CAMERA, workers=Workers(), lighting=lighting).render(
            reef(seed, length=1.0), pose_of(seed), water, seed=seed)
        config = PipelineConfig.from_parameters(lighting_parameters(lamps, daylight=False))
        yield LampCase(
            frame.left, CAMERA.rig.range_from_disparity(frame.disparity_left), 0.0,
            config.camera.transfer, CLEAR_WATER, frame.attenuation, f"reef {seed}",
            config.lighting, CAMERA.rig.focal_length)


def pose_of(seed: int) -> Pose:
    """Draw a pose over a reef, facing ahead and tilted down by 8 to 30 degrees."""
    random = np.random.default_rng([seed, 5])
    return Pose(
        (random.uniform(0.0, 1.0), 0.0, random.uniform(1.2, 1.9)),
        heading=random.uniform(-0.3, 0.3),
        tilt=np.radians(random.uniform(8.0, 30.0)),
        roll=np.radians(random.uniform(-3.0, 3.0)),
    )


def observe(case: LampCase) -> Night | None:
    """Reduce a case to nodes; None if there are too few."""
    lamps = estimate_by_lamps(case).lamps
    assert case.attenuation is not None
    return None if lamps is None or lamps.nodes is None else Night(
        lamps.nodes, case.lighting, case.clear_water, case.attenuation)


def between_channels(scenes: Sequence[Scene]) -> float:
    """Standard deviation of ln (albedo / reflectance) of a channel about the channels' mean.

    Reflectance is that of the median patch of a scene, albedo the belief `lamps.albedo`.
    """
    found = []
    for index, scene in enumerate(scenes):
        streams = Streams(np.random.default_rng((SEED, index)))
        reflectance, ranges, _ = vary(streams("scene"), scene)
        side = reflectance.shape[1] // PATCHES
        shown = np.where(np.isfinite(ranges)[..., np.newaxis], reflectance, np.nan)
        patches = means(shown, side)
        scattering = streams("albedo")
        albedo = [draw(scattering, "lamps.albedo") for _ in range(3)]
        found.append(np.log(albedo) - np.log(np.nanmedian(patches, axis=(0, 1)) + BLACK))
    each = np.array(found)
    return float((each - each.mean(axis=1, keepdims=True)).std())


def score(fitted: Fitted, night: Night) -> float:
    """Logarithm of the posterior's density at the true ln β of the clearest channel."""
    found = infer(
        [night.nodes], night.lighting, night.clear_water, np.ones(3, np.bool_), fitted)
    if found is None:
        return math.nan
    best = int(np.argmin(night.attenuation))
    deviation = math.sqrt(found.covariance[best, best])
    off = (found.log_attenuation[best] - math.log(night.attenuation[best])) / deviation
    return -0.5 * min(abs(off), WRONG) ** 2 - math.log(deviation * math.sqrt(2.0 * math.pi))


def main() -> None:
    """Print the fitted numbers."""
    if not 2 <= len(sys.argv) <= 3:
        sys.exit("give a folder of scenes (see python -m uw_visibility_lab.worlds) [and cases]")
    scenes = [load_scene(path) for path in scenes_of(Path(sys.argv[1]))[:SCENES]]
    print(f"OF_CHANNELS: {between_channels(scenes):.2f}", flush=True)
    number = int(sys.argv[2]) if len(sys.argv) == 3 else CASES
    kinds = [
        [night for night in map(observe, cases) if night is not None]
        for cases in (
            by_lamps(scenes, number, SEED), by_lamps(scenes, number, SEED + 1, (), None, EVEN),
            islice(reefs(number), number))]
    with process_pool(os.cpu_count() or 1, use_one_thread) as pool:
        def scores(fitted: Fitted) -> Array:
            return np.array([
                np.nanmean(list(pool.map(partial(score, fitted), nights, chunksize=4)))
                for nights in kinds])

        fitted, most = FITTED, float(scores(FITTED).mean())
        print(f"{FITTED}: {most:.4f}", flush=True)
        for _ in range(ROUNDS):
            for name in Fitted._fields:
                for factor in (STEP, 1.0 / STEP):
                    while True:
                        tried = fitted._replace(**{name: getattr(fitted, name) * factor})
                        found = scores(tried)
                        print(f"{name} {getattr(tried, name):.4g}: {found.round(3)}", flush=True)
                        if not found.mean() > most + GAIN:
                            break
                        fitted, most = tried, float(found.mean())
    print(f"{fitted}: {most:.4f}")


if __name__ == "__main__":
    main()
