# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Ranges as they are measured."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility_lab.worlds.ranging import measure_ranges, occluded

SHAPE = (60, 80)


def streams(purpose: str) -> np.random.Generator:
    return np.random.default_rng([7, len(purpose)])


def slope() -> np.ndarray:
    return np.broadcast_to(np.linspace(6.0, 2.0, SHAPE[0])[:, np.newaxis], SHAPE).astype(
        np.float32)


def textured() -> np.ndarray:
    return np.random.default_rng(0).integers(40, 200, (*SHAPE, 3)).astype(np.uint8)


def test_without_effects_ranges_are_the_truth() -> None:
    truth = slope()
    truth[:10] = np.inf
    ranges, error = measure_ranges(streams, truth, textured(), ())
    assert error == 0.0
    assert np.isnan(ranges[:10]).all()
    np.testing.assert_array_equal(ranges[10:], truth[10:])


def test_told_error_is_that_of_the_noise() -> None:
    errors, told = [], []
    for seed in range(30):
        def seeded(purpose: str, seed: int = seed) -> np.random.Generator:
            return np.random.default_rng([seed, len(purpose)])
        ranges, error = measure_ranges(seeded, slope(), textured(), ("disparity noise",))
        errors.append(np.nanstd(1.0 / ranges - 1.0 / slope()))
        told.append(error)
    ratio = np.array(told) / np.array(errors)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.15)


def test_what_a_near_thing_hides_is_occluded() -> None:
    truth = np.full(SHAPE, 4.0, np.float32)
    truth[:, 40:60] = 1.0
    hidden = occluded(truth, 8.0)
    # Disparities are 2 and 8 px: of six columns left of the thing the first is half hidden, and
    # two are beyond the right image's edge.
    np.testing.assert_array_equal(np.nonzero(hidden[30])[0], [0, 1, *range(35, 40)])


def test_flat_areas_are_not_matched() -> None:
    image = textured()
    image[:, :40] = 90
    ranges, _ = measure_ranges(streams, slope(), image, ("unmatched",))
    known = np.isfinite(ranges)
    assert known[:, 50:].mean() > 0.5
    assert known[:, :30].mean() < 0.1


def test_a_mesh_keeps_planes_and_rounds_edges() -> None:
    truth = 1.0 / np.linspace(1.0 / 6.0, 1.0 / 2.0, SHAPE[0])[:, np.newaxis]
    truth = np.broadcast_to(truth, SHAPE).astype(np.float32)
    ranges, error = measure_ranges(streams, truth, textured(), ("mesh",))
    assert error == 0.0
    assert np.nanmedian(np.abs(1.0 / ranges - 1.0 / truth)) < 0.03
    edge = truth.copy()
    edge[:, 40:] *= 0.3
    ranges, _ = measure_ranges(streams, edge, textured(), ("mesh",))
    between = (ranges > 1.1 * edge.min(axis=1, keepdims=True)) & (
        ranges < 0.9 * edge.max(axis=1, keepdims=True))
    assert between[:, 30:50].any() and not between[:, :20].all()


def test_scale_and_patches_are_wrong_as_named() -> None:
    scaled, _ = measure_ranges(streams, slope(), textured(), ("range scale",))
    factor = scaled / slope()
    assert factor.std() < 1e-5
    assert 0.0 < abs(factor.mean() - 1.0) <= 0.08
    patched, _ = measure_ranges(streams, slope(), textured(), ("wrong patches",))
    wrong = patched != slope()
    assert 0.0 < wrong.mean() < 0.2
