# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Random lamps at night: light falls with their distance, and the veil grows with range."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.images.arrays import Map
from uw_visibility_lab.worlds.draw import draw
from uw_visibility_lab.worlds.lamps import draw_lamps, light_by_lamps
from uw_visibility_lab.worlds.scenes import Scene

SHAPE = (48, 64)


def lit(distance: float, attenuation: float, seed: int = 1) -> tuple[Map, Map]:
    return light_by_lamps(
        np.random.default_rng(seed), np.full((*SHAPE, 3), 0.5, np.float32),
        np.full(SHAPE, distance, np.float32), np.full(3, attenuation))


def test_the_same_seed_gives_the_same_lamps() -> None:
    one, other, third = (draw_lamps(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one == other != third
    assert {len(draw_lamps(np.random.default_rng(seed))) for seed in range(20)} == {1, 2, 4}


@pytest.mark.parametrize("attenuation", [0.0, 0.03])
def test_light_falls_with_the_square_of_distance_and_both_ways_through_the_water(
    attenuation: float
) -> None:
    # Lamps are within a metre of the camera: from 20 and from 40 m they are at one place.
    (near, _), (far, _) = lit(20.0, attenuation), lit(40.0, attenuation)
    middle = np.s_[20:28, 28:36]
    expected = 0.25 * np.exp(-2.0 * attenuation * 20.0)
    assert (far[middle] / near[middle]).mean() == pytest.approx(expected, rel=0.05)


def test_the_veil_grows_with_range_to_a_bound_and_needs_water() -> None:
    _, near = lit(2.0, 0.2)
    _, far = lit(8.0, 0.2)
    _, farther = lit(16.0, 0.2)
    assert (near > 0.0).all() and (far > near).all()
    assert (farther - far).max() < 0.1 * far.max()
    assert not lit(8.0, 0.0)[1].any()


def test_a_view_by_lamps_is_dark_where_nothing_is_near() -> None:
    """By day, open water is as bright as the veil; at night it shows the lamps' own light alone."""
    rows = np.linspace(6.0, 1.0, 240, dtype=np.float32)
    ranges = np.repeat(rows[:, np.newaxis], 320, axis=1)
    ranges[:60] = np.inf
    scene = Scene("floor", "procedural", np.full((240, 320, 3), 0.4, np.float32), ranges)
    dimmer = 0
    for seed in range(12):
        share = []
        for lamps in (False, True):
            view = draw(np.random.default_rng(seed), scene, effects=("noise",), lamps=lamps)
            light = view.image.astype(float).mean(axis=2)
            share.append(light[view.open_water].mean() / light[~view.open_water].max())
        dimmer += share[1] < share[0]
    assert dimmer >= 10
