# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Accuracy and time of the preset for small computers, compared with the default.

    python -m benchmarks.presets

Scenes with known disparity in simulated water, and real boards under water; each row has
one change of the default parameters. Times are processor times of one thread on aloe,
640x480, of calls that take turns, relative to the default.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility import Pipeline, PipelineConfig, StereoRig
from uw_visibility.commands.calibration_file import read_rig
from uw_visibility.config.schema import read_yaml
from uw_visibility.images.files import read_image
from uw_visibility_lab.evaluation.degrade import Scene, load_scene
from uw_visibility_lab.evaluation.metrics import colour_difference, correct_fraction
from uw_visibility_lab.simulation.water import CLEAR_WATER

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
FAST = ROOT / "config" / "fast.yaml"
SCENES = ("aloe", "art", "dolls", "moebius")
ATTENUATIONS = (0.0, 0.1, 0.2, 0.3)
DEPTH = 2.0
# Aloe is reduced to the image size of a usual camera.
SIZE = (640, 480)

Parameters = Mapping[str, Any]

# Another way to save time, for comparison with the preset.
COARSE: Parameters = {"stereo.support_step": 10}


def main() -> None:
    """Print the table."""
    argparse.ArgumentParser(
        prog="python -m benchmarks.presets", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    ).parse_args()
    compare()


def compare(rounds: int = 9) -> dict[str, dict[str, float]]:
    """Measure the default and the presets; print and return the rows."""
    if not DATA.is_dir():
        print(f"\nno presets compared: there is no recorded data in {DATA}")
        return {}
    presets: dict[str, Parameters] = {
        "default": {}, "fast": read_yaml(FAST), "full size, coarse": COARSE,
    }
    times = measure_times(presets, rounds)
    rows = {}
    for number, (name, parameters) in enumerate(presets.items()):
        rows[name] = measure(parameters) | {
            "ms": times[name], "time": times[name] / times["default"],
        }
        if number == 0:
            print(f"\n{'preset':32s}" + "".join(f"{column:>11s}" for column in rows[name]))
        print(f"{name:32s}" + "".join(f"{v:11.3f}" for v in rows[name].values()), flush=True)
    return rows


def make_pipeline(rig: StereoRig, parameters: Parameters) -> Pipeline:
    """Make a pipeline of one thread."""
    return Pipeline(rig, PipelineConfig.from_parameters({**parameters, "threads": 1}))


def measure_times(presets: Mapping[str, Parameters], rounds: int) -> dict[str, float]:
    """Return the median time of a pair by preset, ms."""
    rig, left, right, _, _ = degrade(load_scene(DATA / "middlebury" / "aloe"), 0.2)
    cv2.setNumThreads(1)
    times = take_turns(
        {name: partial(make_pipeline(rig, values).process, left, right)
         for name, values in presets.items()}, rounds)
    return {name: statistics.median(values) for name, values in times.items()}


def take_turns(
    candidates: Mapping[str, Callable[[], Any]], rounds: int,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, list[float]]:
    """Time every candidate once per round, after a warm-up round that does not count; ms."""
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for turn in range(rounds + 1):
        for name, call in candidates.items():
            begin = clock()
            call()
            if turn:
                times[name].append(1e3 * (clock() - begin))
    return times


def measure(parameters: Parameters) -> dict[str, float]:
    """Return correct fractions, error of the mean attenuation (1/m) and colour difference."""
    correct: dict[float, list[float]] = {alpha: [] for alpha in ATTENUATIONS}
    errors, differences = [], []
    for name in SCENES:
        scene = load_scene(DATA / "middlebury" / name)
        for alpha in ATTENUATIONS:
            rig, left, right, truth, radiance = degrade(scene, alpha)
            result = make_pipeline(rig, parameters).process(left, right)
            correct[alpha].append(correct_fraction(result.disparity, truth))
            errors.append(abs(result.visibility.mean_attenuation - alpha))
            differences.append(float(colour_difference(result.left_enhanced, radiance).mean()))
    row = {f"ok a={alpha:g}": float(np.mean(found)) for alpha, found in correct.items()}
    row["error of a"] = float(np.nanmean(errors))
    row["delta E"] = float(np.mean(differences))
    return row | {f"ok {name}": boards(name, parameters) for name in ("bermuda", "tank")}


def degrade(
    scene: Scene, alpha: float
) -> tuple[StereoRig, NDArray[Any], NDArray[Any], NDArray[np.float32], NDArray[Any]]:
    """Return geometry, pair, true disparity and left radiance of a scene in water."""
    images = scene.degraded(alpha, DEPTH, CLEAR_WATER)
    width = scene.disparity_left.shape[1]
    rig = scene.rig
    if width <= SIZE[0]:
        return rig, *images, scene.disparity_left, scene.left
    left, right, radiance = (
        cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA) for image in (*images, scene.left)
    )
    scale = SIZE[0] / width
    truth = cv2.resize(scene.disparity_left, SIZE, interpolation=cv2.INTER_NEAREST) * scale
    centre = ((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)
    rig = StereoRig(scene.rig.focal_length * scale, scene.rig.baseline, centre)
    return rig, left, right, truth, radiance


def boards(name: str, parameters: Parameters) -> float:
    """Return the mean share of correct disparities on the boards of real pairs."""
    folder = DATA / "underwater" / name
    rig, _ = read_rig([folder / "calibration.json"])
    planes = json.loads((folder / "board_planes.json").read_text(encoding="utf-8"))
    shares = []
    for number, board in planes.items():
        left, right = (read_image(folder / f"{side}_{number}.png") for side in ("left", "right"))
        result = make_pipeline(rig, parameters).process(left, right)
        a, b, c = board["disparity_plane_abc"]
        y, x = np.mgrid[: left.shape[0], : left.shape[1]]
        inside = np.zeros(left.shape[:2], np.uint8)
        cv2.fillConvexPoly(inside, np.round(board["corners_left_rect"]).astype(np.int32), 1)
        truth = np.where(inside > 0, a * x + b * y + c, np.nan).astype(np.float32)
        shares.append(correct_fraction(result.disparity, truth))
    return float(np.mean(shares))


if __name__ == "__main__":
    main()
