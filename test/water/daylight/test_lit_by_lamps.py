# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Lamps that the parameters do not tell of are found, and daylight is not taken for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lamp_scene import CLEAR_WATER, SIZE, ground, render, texture
from scenes import codes

from uw_visibility.config.schema import WaterConfig
from uw_visibility.images.view import View
from uw_visibility.optics.light_model import attenuate
from uw_visibility.status import Status
from uw_visibility.water.daylight import estimation
from uw_visibility.water.daylight.estimation import WaterEstimator


def estimator() -> WaterEstimator:
    return WaterEstimator(WaterConfig(), CLEAR_WATER)


@pytest.mark.parametrize("alpha", [0.05, 0.15, 0.3])
def test_a_night_frame_says_what_to_set(alpha: float) -> None:
    shown = render(alpha, seed=1)
    found = estimator().estimate_view(View.of(shown.image), shown.range, range_error=0.0)
    assert found.status is Status.LIT_BY_LAMPS
    assert "set lighting.model" in str(found.status)
    assert not np.isfinite(found.attenuation).any()


@pytest.mark.parametrize(
    ("probability", "status"),
    [(0.02, Status.OK), (0.05, Status.LIGHT_UNCERTAIN), (0.8, Status.LIT_BY_LAMPS)])
def test_light_that_is_not_certain_tells_no_water(
    monkeypatch: pytest.MonkeyPatch, probability: float, status: Status
) -> None:
    """A view by lamps that passes for daylight has water that is wrong many times over."""
    distance = ground().astype(np.float32)
    image = attenuate(
        texture(0, distance), distance, CLEAR_WATER + 0.2, np.full(3, 0.4), np.full(3, 0.8))
    infer = estimation.infer
    monkeypatch.setattr(
        estimation, "infer", lambda *told: replace(infer(*told), lamps=probability))
    found = estimator().estimate_view(
        View.of(codes(image, np.uint16)), distance, range_error=0.0)
    assert found.status is status
    assert np.isfinite(found.attenuation).any() == (status is Status.OK)


@pytest.mark.parametrize("veil", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("alpha", [0.02, 0.3])
def test_daylight_is_not_taken_for_lamps(alpha: float, veil: float) -> None:
    distance = ground().astype(np.float32)
    for seed in range(3):
        image = attenuate(
            texture(seed, distance), distance, CLEAR_WATER + alpha, np.full(3, 0.8 * veil),
            np.full(3, 0.8))
        found = estimator().estimate_view(
            View.of(codes(image, np.uint16)), distance, range_error=0.0)
        assert found.status not in (Status.LIT_BY_LAMPS, Status.LIGHT_UNCERTAIN)


@pytest.mark.parametrize("near", [0.5, 0.8])
@pytest.mark.parametrize("veil", [0.1, 0.3])
def test_a_white_board_before_dull_ground_is_not_taken_for_lamps(near: float, veil: float) -> None:
    """By day too it is brighter than all behind it, but the fall is one step."""
    height, width = SIZE
    row, column = np.mgrid[:height, :width]
    distance = np.linspace(1.6, 1.0, height, dtype=np.float32)[:, np.newaxis] + 0 * column
    board = (abs(row - height / 2) < height / 4) & (abs(column - width / 2) < width / 4)
    distance[board] = near * (1.0 + 0.3 * column[board] / width)
    squares = 0.1 + 0.85 * ((row // 12 + column // 12) % 2)
    for seed in range(3):
        radiance = np.where(
            board[..., np.newaxis], squares[..., np.newaxis], 0.15 * texture(seed, distance))
        image = attenuate(
            radiance, distance, CLEAR_WATER + 0.05, np.full(3, 0.9 * veil), np.full(3, 0.9))
        found = estimator().estimate_view(
            View.of(codes(image, np.uint16)), distance.astype(np.float32), range_error=0.0)
        assert found.status is not Status.LIT_BY_LAMPS


@pytest.mark.parametrize("far", [1.5, 2.6])
def test_light_that_falls_on_board_and_ground_as_lamps_have_it_is_taken_for_lamps(
    far: float,
) -> None:
    """What fades by the 1.8th power of range, behind next to no veil, is not even daylight."""
    height, width = SIZE
    row, column = np.mgrid[:height, :width]
    distance = np.linspace(far, 1.05, height)[:, np.newaxis] + 0.0 * column
    board = (abs(row - height / 2) < height / 4) & (abs(column - width / 2) < width / 4)
    distance[board] = 0.45 * (1.0 + 0.3 * column[board] / width)
    squares = 0.1 + 0.85 * ((row // 12 + column // 12) % 2)
    shade = np.where(board, 0.45 / distance, 1.05 / distance) ** 1.8
    lamps = []
    for seed in range(3):
        radiance = np.where(
            board[..., np.newaxis], squares[..., np.newaxis], 0.25 * texture(seed, distance))
        image = attenuate(
            radiance * shade[..., np.newaxis], distance.astype(np.float32), CLEAR_WATER + 0.02,
            np.full(3, 0.05), np.full(3, 0.9))
        found = estimator().estimate_view(
            View.of(codes(image, np.uint16)), distance.astype(np.float32), range_error=0.0)
        lamps.append(found.status is Status.LIT_BY_LAMPS)
    assert sum(lamps) >= 2
