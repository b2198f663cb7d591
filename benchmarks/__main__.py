# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Time the pipeline and its stages, as ratios to OpenCV's StereoSGBM in the same run.

Absolute times of shared machines drift by a factor of two; a ratio of calls that
take turns does not. Each round runs every candidate once, and the medians over
the rounds are compared.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.presets import compare, take_turns
from uw_visibility import Pipeline, PipelineConfig, StereoRig
from uw_visibility.compute.memory import keep_freed_memory
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Image8
from uw_visibility.images.noise import noise_stddev
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas import Matcher
from uw_visibility_lab.evaluation.baselines import sgbm
from uw_visibility_lab.evaluation.degrade import load_scene
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.frame import Renderer
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.water import CLEAR_WATER, Water

# Width, height and number of disparities of each case.
CASES = ((640, 480, 128), (1280, 960, 256))
SCENE = Path(__file__).resolve().parents[1].parent / "shared" / "data" / "middlebury" / "aloe"
MEAN_ATTENUATION = 0.2
DEPTH = 2.0
# Standard deviation, codes.
NOISE = 2.0


def main() -> None:
    """Run the benchmarks, print tables and write the ratios."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--json", default="bench.json", metavar="FILE", help="ratios, as JSON")
    parser.add_argument("--rounds", type=int, default=15, help="rounds of each case")
    parser.add_argument("--small", action="store_true", help="640x480 only")
    options = parser.parse_args()
    # As the node and the commands do.
    keep_freed_memory()
    report: dict[str, dict[str, Any]] = {}
    for width, height, disparities in CASES[: 1 if options.small else None]:
        left, right, source = load_pair(width, height)
        print(f"\n{source}, {width}x{height} px, {disparities} disparities")
        sizes = report.setdefault(f"{width}x{height}", {})
        for threads in (1, 2):
            sizes[str(threads)] = run_case(left, right, disparities, threads, options.rounds)
    if not options.small:
        for threads in ("1", "2"):
            small, large = (report[f"{w}x{h}"][threads] for w, h, _ in CASES)
            large["over_small"] = large["pipeline_ms"] / small["pipeline_ms"]
            print(f"{threads} thread(s): large over small {large['over_small']:.2f}")
    report["presets"] = compare(options.rounds)
    Path(options.json).write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    print(f"\nratios written to {options.json}")


def load_pair(width: int, height: int) -> tuple[Image8, Image8, str]:
    """Return a turbid pair: aloe if there is recorded data, otherwise a rendered reef."""
    if not SCENE.is_dir():
        camera = StereoCamera(width, height, focal_length=600.0 * width / 640)
        water = Water(MEAN_ATTENUATION, DEPTH)
        frame = Renderer(camera).render(reef(), Pose((0.0, 0.0, 1.5), tilt=0.3), water)
        return frame.left, frame.right, f"rendered reef at {MEAN_ATTENUATION} 1/m"
    scene = load_scene(SCENE)
    left, right = (
        cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        for image in scene.degraded(MEAN_ATTENUATION, DEPTH, CLEAR_WATER)
    )
    return left, right, f"aloe at {MEAN_ATTENUATION} 1/m"


def run_case(
    left: Image8, right: Image8, disparities: int, threads: int, rounds: int
) -> dict[str, float]:
    """Time one size with one number of threads; return ratios and medians."""
    height, width = left.shape[:2]
    cv2.setNumThreads(threads)
    workers = Workers(threads)
    rig = StereoRig(3740.0 * width / 1282, 0.160, ((width - 1) / 2, (height - 1) / 2))
    config = PipelineConfig.from_parameters(
        {"stereo.max_disparity": disparities - 1, "threads": threads}
    )
    pipeline = Pipeline(rig, config)
    matcher = Matcher((height, width), (0, disparities - 1), config.stereo, workers)
    contrast = ContrastNormalizer((height, width)), ContrastNormalizer((height, width))
    for view, image in zip(contrast, (left, right), strict=True):
        view.stretch(image, workers, noise_stddev(image))
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (left, right)]
    random = np.random.default_rng(0)
    noisy = [
        np.clip(np.rint(image + random.normal(0.0, NOISE, image.shape)), 0, 255).astype(np.uint8)
        for image in (left, right)]
    peer = sgbm(disparities, 1)
    # OpenCV's default searches five directions in one pass instead of eight in two.
    single_pass = sgbm(disparities, 1)
    single_pass.setMode(cv2.StereoSGBM_MODE_SGBM)

    def match() -> None:
        for side, view in enumerate(contrast):
            matcher.describe_view(side, view)
        matcher.dense_disparity(matcher.support_points())

    stages: dict[str, list[float]] = {}

    def process() -> None:
        for stage, milliseconds in pipeline.process(left, right).timing_ms.items():
            stages.setdefault(stage, []).append(milliseconds)

    times = take_turns(
        {
            "sgbm": lambda: peer.compute(*grey),
            "sgbm, single pass": lambda: single_pass.compute(*grey),
            "matcher": match,
            "pipeline": process,
            "pipeline in noise": lambda: pipeline.process(*noisy),
        },
        rounds, time.perf_counter,
    )
    medians = {name: statistics.median(values) for name, values in times.items()}
    print_stages(threads, stages, times)
    return {
        "pipeline_over_sgbm": medians["pipeline"] / medians["sgbm"],
        "matcher_over_sgbm": medians["matcher"] / medians["sgbm"],
        "in_noise_over_pipeline": medians["pipeline in noise"] / medians["pipeline"],
        "pipeline_over_single_pass": medians["pipeline"] / medians["sgbm, single pass"],
        "matcher_over_single_pass": medians["matcher"] / medians["sgbm, single pass"],
        "pipeline_ms": medians["pipeline"],
        "matcher_ms": medians["matcher"],
        "sgbm_ms": medians["sgbm"],
    }


def print_stages(
    threads: int, stages: dict[str, list[float]], times: dict[str, list[float]]
) -> None:
    """Print median, spread and share of each stage, and the ratios."""
    total = statistics.median(stages["total"][1:])
    print(f"\n  {threads} thread(s)                  median ms   min .. max      share")
    peer = statistics.median(times["sgbm"])
    rows = [(name, values[1:], "{:8.1%}", total) for name, values in stages.items()]
    rows += [
        (f"[{name}]", values, "{:8.2f} x StereoSGBM", peer) for name, values in times.items()]
    for name, values, share, whole in rows:
        middle = statistics.median(values)
        print(f"  {name:28s} {middle:9.2f}   {min(values):7.2f} .. {max(values):7.2f} "
              + share.format(middle / whole))


if __name__ == "__main__":
    main()
