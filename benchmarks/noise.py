# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Noise of the sensor as an axis: what ours and the peers match, and what ours takes for it.

    python -m benchmarks.noise [SCENE ...]

Scenes of the Middlebury form in simulated water; art, dolls and moebius where they are at
hand, else rendered ones. Shares are of the pixels with known truth, means over the scenes.
Times are the processors' for the pipeline, at each noise over those without, taking turns.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import take_turns
from uw_visibility import Pipeline, PipelineConfig
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility_lab.evaluation.baselines import equalised_matching, semi_global_matching
from uw_visibility_lab.evaluation.degrade import CAMERA, Scene, sensor_of, title_of
from uw_visibility_lab.evaluation.metrics import bad_fraction, correct_fraction
from uw_visibility_lab.evaluation.scenes import find_scenes, search_limit, tolerance

DATA = Path(__file__).resolve().parents[1].parent / "shared" / "data" / "middlebury"
SCENES = ("art", "dolls", "moebius")
ATTENUATIONS = (0.1, 0.2, 0.3)
DEPTH = 2.0
NOISES = ("0", "1", "2", "4", CAMERA)
METHODS = ("ours", "SGBM", "CLAHE + SGBM")
TIMED_ATTENUATION = 0.2


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.noise", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("datasets", nargs="*", type=Path, metavar="SCENE")
    compare(parser.parse_args().datasets, rounds=5)


def compare(datasets: Sequence[Path], rounds: int) -> dict[str, dict[str, float]]:
    """Print correct and wrong shares by noise and α, and the times by noise; return them."""
    folders = datasets or [DATA / name for name in SCENES if (DATA / name).is_dir()]
    scenes = [source.load() for source in find_scenes(folders)]
    names = ", ".join(scene.name for scene in scenes)
    print(f"\n{names} at {DEPTH:g} m: correct / wrong of matched")
    print(f"{'':22s}{'α':>4s}  " + "".join(f"{name:>18s}" for name in METHODS))
    table: dict[str, dict[str, float]] = {}
    for noise in NOISES:
        for alpha in ATTENUATIONS:
            rows = [match(scene, alpha, noise) for scene in scenes]
            shares = {
                f"{what} {name}": float(np.nanmean([row[name][k] for row in rows]))
                for name in METHODS for k, what in enumerate(("correct", "wrong"))
            }
            table[f"noise {noise}, a={alpha:g}"] = shares
            cells = (f"{shares[f'correct {n}']:.3f} / {shares[f'wrong {n}']:.3f}" for n in METHODS)
            print(f"{title_of(noise):22s}{alpha:>4g}  " + "".join(f"{c:>18s}" for c in cells))
    times = measure_times(scenes[0], rounds)
    for noise, ratio in times.items():
        print(f"time with {title_of(noise)}, over that without: {ratio:.2f}")
    return table | {"time over that without noise": times}


def match(scene: Scene, alpha: float, noise: str) -> dict[str, tuple[float, float]]:
    """Return correct and wrong share of each method."""
    left, right = pair(scene, alpha, noise)
    disparities = search_limit(scene)
    found = {
        "ours": make_pipeline(scene).process(left, right).disparity,
        "SGBM": semi_global_matching(left, right, disparities),
        "CLAHE + SGBM": equalised_matching(left, right, disparities),
    }
    truth, limit = scene.disparity_left, tolerance(scene)
    return {
        name: (correct_fraction(d, truth, limit), bad_fraction(d, truth, limit))
        for name, d in found.items()
    }


def measure_times(scene: Scene, rounds: int) -> dict[str, float]:
    """Return the pipeline's median time at each noise over that without."""
    pairs = {noise: pair(scene, TIMED_ATTENUATION, noise) for noise in NOISES}
    pipeline = make_pipeline(scene)
    times = take_turns(
        {noise: partial(pipeline.process, *images) for noise, images in pairs.items()}, rounds)
    medians = {noise: statistics.median(values) for noise, values in times.items()}
    return {noise: value / medians["0"] for noise, value in medians.items()}


def make_pipeline(scene: Scene) -> Pipeline:
    """Return a pipeline of one thread for a scene."""
    rig = scene.rig
    parameters = {"stereo.max_disparity": search_limit(scene) - 1, "threads": 1}
    return Pipeline(rig, PipelineConfig.from_parameters(parameters))


def pair(scene: Scene, alpha: float, noise: str) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return a scene's pair in water, with noise."""
    kappa = clear_water_attenuation(load_response("nikon_d5100"))
    return scene.degraded(alpha, DEPTH, kappa, sensor_of(noise))


if __name__ == "__main__":
    main()
