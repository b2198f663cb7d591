# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames reduced to nodes: light, slopes, and differences on every scale."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lamp_scene import LAMPS, RIG, SIZE, parameters, rays

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.view import View
from uw_visibility.optics.lamps import LEFT_EYE, tabulate
from uw_visibility.water.blocks import reduce_to_blocks
from uw_visibility.water.lamps.nodes import USELESS, Nodes, details_of, reduce_to_nodes


def matrix(frames: list[np.ndarray]) -> np.ndarray:
    """Details as a matrix, (rows, nodes)."""
    details = details_of(frames)
    rows = np.zeros((len(details.level), sum(map(len, frames))))
    for i in range(len(rows)):
        own = slice(details.first[i], details.first[i + 1])
        rows[i, details.node[own]] = details.weight[own]
    return rows


def grid(height: int, width: int) -> np.ndarray:
    return np.argwhere(np.ones((height, width), bool))


@pytest.mark.parametrize("frames", [[(8, 8)], [(4, 4)] * 4, [(2, 4), (2, 4)]])
def test_details_of_full_grids_are_all_that_differs_and_independent(
    frames: list[tuple[int, int]]
) -> None:
    rows = matrix([grid(*shape) for shape in frames])
    number = rows.shape[1]
    assert len(rows) == number - 1
    np.testing.assert_allclose(rows @ rows.T, np.eye(number - 1), atol=1e-12)
    np.testing.assert_allclose(rows.sum(axis=1), 0.0, atol=1e-12)


@given(st.lists(st.tuples(st.integers(0, 14), st.integers(0, 9)), min_size=1, unique=True))
def test_details_of_any_nodes_have_the_variance_of_white_noise(places: list) -> None:
    rows = matrix([np.array(sorted(places))])
    assert len(rows) <= len(places) - 1
    np.testing.assert_allclose((rows**2).sum(axis=1), 1.0)
    np.testing.assert_allclose(rows.sum(axis=1), 0.0, atol=1e-9)


def reduced(light: np.ndarray, distance: np.ndarray) -> Nodes:
    lamps = tuple(PipelineConfig.from_parameters(parameters(LAMPS)).lighting.lamps())
    tables = tabulate(RIG.rays_at, SIZE, lamps, LEFT_EYE)
    view = View.of(light)
    assert view.colour is not None
    blocks = reduce_to_blocks(view.colour, distance.astype(np.float32), None)
    directions = RIG.rays_at(*(
        (np.arange(size) + 0.5) * blocks.side - 0.5 for size in blocks.range.shape[::-1]))
    return reduce_to_nodes(blocks, directions, tables)


def test_slopes_and_ranges_of_a_plane_are_its_own() -> None:
    normal = np.array([0.3, -0.6, -0.8])
    normal /= np.linalg.norm(normal)
    distance = -2.0 / (rays() @ normal)
    distance[(distance < 0) | (distance > 10)] = np.nan
    nodes = reduced(np.full((*SIZE, 3), 20_000, np.uint16), distance)
    assert len(nodes.range) > 100
    np.testing.assert_allclose(nodes.normal, np.tile(normal, (len(nodes.range), 1)), atol=1e-3)
    away = -(nodes.direction @ normal) * nodes.range
    np.testing.assert_allclose(away, 2.0, rtol=5e-3)
    np.testing.assert_allclose(nodes.light, 20_000 / 65535, rtol=1e-3)


def test_what_is_black_or_white_tells_nothing_and_edges_are_no_surface() -> None:
    light = np.full((*SIZE, 3), 100, np.uint8)
    light[:40], light[-40:] = 1, 255
    distance = np.full(SIZE, 2.0)
    distance[:, 100::2] = 4.0
    nodes = reduced(light, distance)
    useless = (nodes.variance > USELESS**2).all(axis=1)
    rows = nodes.place[:, 0] / nodes.place[:, 0].max()
    assert useless[rows < 0.2].all() and useless[rows > 0.8].all()
    assert not useless[(rows > 0.4) & (rows < 0.6)].any()
    assert nodes.place[:, 1].max() <= 0.55 * SIZE[1] / (SIZE[0] / (nodes.place[:, 0].max() + 1))
