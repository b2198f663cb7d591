# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What airlight adds as a matching cue: disparities with it and without, in one table.

python -m benchmarks.airlight [SCENE ...], each a folder of the Middlebury form; without
one, rendered scenes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from uw_visibility import Pipeline, PipelineConfig
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility_lab.evaluation.metrics import correct_fraction, matched_fraction
from uw_visibility_lab.evaluation.scenes import find_scenes, search_limit, tolerance

ATTENUATIONS = (0.0, 0.1, 0.2, 0.3)
DEPTH = 2.0
SETTINGS = {"without": {"stereo.airlight_prior": 0.0}, "with": {}}


def main() -> None:
    """Print correct and unmatched shares, scene by scene, and their means."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.airlight", description=__doc__)
    parser.add_argument("datasets", nargs="*", type=Path, metavar="SCENE")
    kappa = clear_water_attenuation(load_response("nikon_d5100"))
    print(f"{'scene':12s}{'α':>5s}   " + "".join(
        f"{what + ' ' + name:>20s}" for what in ("correct", "unmatched") for name in SETTINGS))
    table = []
    for source in find_scenes(parser.parse_args().datasets):
        scene = source.load()
        rig = scene.rig
        limit = {"stereo.max_disparity": search_limit(scene) - 1}
        pipelines = [
            Pipeline(rig, PipelineConfig.from_parameters({**limit, **setting}))
            for setting in SETTINGS.values()
        ]
        for attenuation in ATTENUATIONS:
            pair = scene.degraded(attenuation, DEPTH, kappa)
            found = [pipeline.process(*pair).disparity for pipeline in pipelines]
            row = [correct_fraction(d, scene.disparity_left, tolerance(scene)) for d in found]
            row += [1.0 - matched_fraction(d) for d in found]
            table.append(row)
            print_row(scene.name, f"{attenuation:g}", row)
    print_row("mean", "", list(np.mean(table, axis=0)))


def print_row(name: str, attenuation: str, row: list[float]) -> None:
    """Print one row of the table."""
    print(f"{name:12s}{attenuation:>5s}   " + "".join(f"{value:20.4f}" for value in row))


if __name__ == "__main__":
    main()
