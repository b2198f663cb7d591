# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of enhanced pictures whose faults are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility_lab.evaluation.baselines import balance_by_grey_world, sea_thru
from uw_visibility_lab.posterior import pictures


def noisy(level: float = 100.0, seed: int = 0) -> np.ndarray:
    values = level + np.random.default_rng(seed).normal(0.0, 1.0, (96, 128, 3))
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def test_a_seam_is_its_step_and_a_ramp_is_none() -> None:
    raw = np.full((64, 64, 3), 100, np.uint8)
    seam, ramp = raw.copy(), raw.copy()
    seam[:, 32:] += 20
    ramp += np.linspace(0, 20, 64).astype(np.uint8)[np.newaxis, :, np.newaxis]
    assert pictures.gain_steps(raw, seam).max() == 20.0
    assert pictures.gain_steps(raw, ramp).max() == 1.0
    assert 2.0 <= pictures.gain_steps(raw, ramp, 8).max() <= 3.0


def test_what_the_raw_picture_has_itself_is_no_step() -> None:
    raw = np.full((64, 64, 3), 100, np.uint8)
    raw[:, 32:, 1] = 101
    enhanced = np.where(raw[..., 1:2] == 101, 180, 100).repeat(3, axis=2).astype(np.uint8)
    assert pictures.gain_steps(raw, enhanced).max() == 0.0
    assert pictures.gain_steps(noisy(), noisy(seed=1)).max() > 0.0


def test_noise_is_that_of_flat_areas() -> None:
    raw = noisy()
    doubled = np.clip(2.0 * (raw.astype(float) - 100.0) + 100.0, 0, 255).astype(np.uint8)
    assert pictures.noise_ratio(raw, doubled) == pytest.approx(2.0, rel=0.02)
    assert pictures.noise_ratio(raw, raw) == 1.0
    assert np.isnan(pictures.noise_ratio(np.zeros_like(raw), raw))


def test_peers_do_what_they_are_named_for() -> None:
    rng = np.random.default_rng(2)
    scene = rng.uniform(40, 200, (96, 128, 1)).repeat(3, axis=2)
    cast = (scene * np.array([0.3, 0.8, 1.0])).astype(np.uint8)
    means = balance_by_grey_world(cast).reshape(-1, 3).mean(axis=0)
    assert np.ptp(means) < 1.0
    # Water whose veil is known to the fit, from black to white patches at each range.
    ranges = np.linspace(0.5, 6.0, 128, dtype=np.float32)[np.newaxis].repeat(96, axis=0)
    left = np.exp(-np.array([0.5, 0.3, 0.25]) * ranges[..., np.newaxis])
    seen = rng.choice((0.0, 0.9), (96, 128, 1)) * left + [0.2, 0.4, 0.5] * (1.0 - left)
    image = np.rint(255.0 * seen).astype(np.uint8)
    restored = sea_thru(image, ranges)
    far = np.s_[:, 96:]
    assert restored[far].std() > 2.0 * image[far].std()
    unknown = np.full_like(ranges, np.nan)
    np.testing.assert_array_equal(sea_thru(image, unknown), image)


def test_every_method_has_its_row() -> None:
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 256, (96, 160, 3)).astype(np.uint8)
    rig = pictures.StereoRig(200.0, 0.1, (79.5, 47.5))
    pair = pictures.Pair(
        "texture", texture, np.roll(texture, -8, axis=1), rig,
        rig.range_from_disparity(np.full((96, 160), 8, np.float32)), texture)
    rows = pictures.compare(pair, PipelineConfig())
    dim = np.rint(0.25 * texture).astype(np.uint8)
    dimmed = pictures.compare(
        pair._replace(left=dim, right=np.roll(dim, -8, axis=1)), PipelineConfig())[0]
    assert dimmed.method == "raw" and 0.0 < dimmed.colour < 1.0
    assert [row.method for row in rows] == ["raw", "ours", "CLAHE", "grey world", "Sea-thru"]
    assert rows[0].colour == 0.0 < rows[0].flicker
    both = pictures.summary(rows + rows)
    assert [row.method for row in both] == [row.method for row in rows]
    assert both[2].noise == rows[2].noise
    assert both[2].steps.size == 2 * rows[2].steps.size
    assert all(len(pictures.line_of("one", row)) == len(pictures.HEAD) for row in rows)


def test_a_folder_without_pairs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no pairs"):
        list(pictures.real_pairs(tmp_path))
