# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The matting solve against its fast form: errors beside depth edges, elsewhere, and time.

python -m benchmarks.matting [SCENE ...], each a folder of the Middlebury form; without
one, rendered scenes.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from uw_visibility import Pipeline, PipelineConfig
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility_lab.evaluation.depth_edges import DISTANCE, MAPS, edge_errors
from uw_visibility_lab.evaluation.scenes import find_scenes, search_limit

MEAN_ATTENUATION = 0.2
DEPTH = 2.0


def main() -> None:
    """Print the table of each scene, and their mean."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.matting", description=__doc__)
    parser.add_argument("datasets", nargs="*", type=Path, metavar="SCENE")
    kappa = clear_water_attenuation(load_response("nikon_d5100"))
    tables = []
    print(f"within {DISTANCE} px of depth edges / elsewhere, α = {MEAN_ATTENUATION:g} 1/m")
    for source in find_scenes(parser.parse_args().datasets):
        scene = source.load()
        config = PipelineConfig.from_parameters(
            {"stereo.max_disparity": search_limit(scene) - 1, "threads": 1})
        rig = scene.rig
        left, right = scene.degraded(MEAN_ATTENUATION, DEPTH, kappa)
        result = Pipeline(rig, config).process(left, right)
        times: dict[str, float] = {}
        call = functools.partial(timed, times)
        errors = edge_errors(scene, left, right, result, rig, config, call)
        tables.append([
            (e.disparity_near, e.disparity_elsewhere, e.colour_near, e.colour_elsewhere,
             times.get(e.map, np.nan)) for e in errors
        ])
        print_table(scene.name, np.array(tables[-1]))
    print_table("mean", np.mean(tables, axis=0))


def timed(times: dict[str, float], name: str, refine: Callable[[], np.ndarray]) -> np.ndarray:
    """Refine, and note the processor time, ms, once memory is allocated."""
    refine()
    begin = time.thread_time()
    found = refine()
    times[name] = 1e3 * (time.thread_time() - begin)
    return found


def print_table(name: str, table: np.ndarray) -> None:
    """Print the errors of each map of one scene."""
    print(f"\n  {name:28s}{'disparity, px':>16s}{'ΔE*ab':>18s}{'ms, 1 thread':>14s}")
    for title, row in zip(MAPS.values(), table, strict=True):
        spent = f"{row[4]:14.1f}" if np.isfinite(row[4]) else ""
        print(f"  {title:28s}{row[0]:8.2f} /{row[1]:6.2f}{row[2]:10.2f} /{row[3]:6.2f}{spent}")


if __name__ == "__main__":
    main()
