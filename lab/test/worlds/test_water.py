# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water composed of spectra lies where sea water does."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility_lab.worlds.water import PATHS, RESPONSES, draw_water

MANY = 300


def waters(**options: bool) -> list:
    return [draw_water(np.random.default_rng([4, k]), **options) for k in range(MANY)]


def test_no_water_is_clearer_than_clear_water() -> None:
    least = np.min([clear_water_attenuation(load_response(name)) for name in RESPONSES], axis=0)
    attenuation = np.array([water.attenuation for water in waters()])
    # Without what molecules scatter forwards, a water may lie a little below K_w.
    assert (attenuation > 0.85 * least).all()
    assert 0.1 < np.median(attenuation.min(axis=1)) < 1.0


def test_light_fades_with_depth_and_red_first() -> None:
    light = np.array([water.light for water in waters()])
    depth = np.array([water.depth for water in waters()])
    assert ((light > 0.0) & (light <= 1.0)).all()
    shallow, deep = light[depth < 2.0], light[depth > 15.0]
    assert np.median(deep) < 0.2 * np.median(shallow)
    # But for brown water, which takes green too.
    assert (deep[:, 0] < deep[:, 1:].max(axis=1)).mean() > 0.9


def test_veil_and_light_are_one_in_a_share_of_waters() -> None:
    ratio = np.array([water.ratio for water in waters()])
    same = (ratio == 1.0).all(axis=1)
    assert 0.15 < same.mean() < 0.45
    assert 0.1 < np.median(ratio[~same].max(axis=1)) < 1.0


def test_band_averages_clear_with_range() -> None:
    for water in waters(spectrum=True)[:50]:
        for table in water.tables:
            rate = -table[1:20] / PATHS[1:20, np.newaxis]
            assert (np.diff(rate, axis=0) <= 1e-9).all()
        start = -water.tables[0][1] / PATHS[1]
        assert start == pytest.approx(water.attenuation, rel=0.02)


def test_red_is_gone_deeper() -> None:
    depth = [np.median([w.depth for w in waters(red_gone=gone)]) for gone in (False, True)]
    assert depth[1] > 1.5 * depth[0]
