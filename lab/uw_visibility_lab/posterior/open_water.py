# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit the odds that unmatched smooth blocks above all surfaces are open water.

python -m uw_visibility_lab.posterior.open_water POOL [VIEWS]
prints the numbers of `uw_visibility.water.daylight.statistics.WATER_ODDS`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from uw_visibility.images.arrays import Array
from uw_visibility.water.daylight.statistics import FEWEST_OF_WATER, appearance_of, open_water
from uw_visibility_lab.posterior.examples import blocks_of
from uw_visibility_lab.worlds.draw import draw
from uw_visibility_lab.worlds.scenes import load_scene
from uw_visibility_lab.worlds.scenes import pool as scenes_of

VIEWS, SEED = 2000, 2
# Least part of water in blocks that count as open water.
MOSTLY = 0.8


def examples(pool: Path, views: int) -> tuple[Array, Array]:
    """Features (N, 3), the first is 1, and whether blocks taken for water mostly are so, (N,)."""
    places = scenes_of(pool)
    features, truth = [], []
    for index in range(views):
        rng = np.random.default_rng((SEED, index))
        view = draw(rng, load_scene(places[int(rng.integers(len(places)))]))
        blocks = blocks_of(view)
        shown = appearance_of(blocks.light)
        water, ragged, width = open_water(blocks.range, shown.counted, shown.smooth)
        if water.sum() < FEWEST_OF_WATER:
            continue
        size = view.image.shape[0] // water.shape[0]
        seen = view.open_water[::size, ::size][:water.shape[0], :water.shape[1]]
        features.append((1.0, ragged, width))
        truth.append(float(seen[water].mean() > MOSTLY))
    return np.array(features), np.array(truth)


def fit(features: Array, truth: Array) -> Array:
    """Return the coefficients of a logistic regression by maximum likelihood, (3,)."""
    def loss(unknown: Array) -> float:
        return float(np.logaddexp(0.0, -(2.0 * truth - 1.0) * (features @ unknown)).sum())

    return np.asarray(minimize(loss, np.zeros(features.shape[1])).x)


def main() -> None:
    """Print the fitted numbers and how often they are right."""
    if not 2 <= len(sys.argv) <= 3:
        sys.exit("give a folder of scenes (see python -m uw_visibility_lab.worlds) [and views]")
    features, truth = examples(
        Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) == 3 else VIEWS)
    found = fit(features, truth)
    right = np.mean((features @ found > 0.0) == truth)
    print(
        f"WATER_ODDS = ({', '.join(f'{x:.2f}' for x in found)}): right in {right:.0%} of "
        f"{len(truth)} views, of which {truth.mean():.0%} show open water there")


if __name__ == "__main__":
    main()
