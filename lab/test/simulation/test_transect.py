# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A transect moves, and its water changes from end to end."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.lamps import Lighting, default_rig
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.transect import Transect
from uw_visibility_lab.simulation.water import WaterEffects

SMALL = StereoCamera(64, 48, 60.0, 0.12)


def test_water_changes_steadily_between_its_ends() -> None:
    transect = Transect(frames=5, depth=(2.0, 6.0), attenuation=(0.3, 0.05), camera=SMALL)
    times, frames = zip(*transect.render(), strict=True)
    assert times == (0.0, 0.5, 1.0, 1.5, 2.0)
    depth = [f.depth for f in frames]
    alpha = [f.mean_attenuation for f in frames]
    assert (depth[0], depth[-1], alpha[0], alpha[-1]) == pytest.approx((2.0, 6.0, 0.3, 0.05))
    assert (np.diff(depth) > 0.0).all()
    assert (np.diff(alpha) < 0.0).all()


def test_lamps_light_what_daylight_does_not_reach() -> None:
    night = Lighting(default_rig(2), daylight=False)
    assert Transect(depth=(4000.0, 4000.0), lighting=night).depth == (4000.0, 4000.0)


def test_another_seed_is_another_reef_and_the_same_seed_the_same() -> None:
    """Noise alone differs little, and ranges have none."""
    ranges = []
    for seed in (0, 1, 0):
        # Else it is the same one, and not one made again.
        reef.cache_clear()
        ranges.append(next(Transect(frames=2, seed=seed, camera=SMALL).render())[1].range_left)
    first, other, again = ranges
    np.testing.assert_array_equal(first, again)
    both = np.isfinite(first) & np.isfinite(other)
    assert np.median(np.abs(other[both] / first[both] - 1.0)) > 0.01


def test_camera_moves_over_the_reef_and_never_into_it() -> None:
    transect = Transect(frames=12, rate=0.5, camera=SMALL)
    frames = [f for _, f in transect.render()]
    assert min(np.nanmin(f.range_left) for f in frames) > 0.6
    for before, after in itertools.pairwise(frames):
        moved = before.range_left != after.range_left
        assert moved[np.isfinite(before.range_left)].all()


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ({"frames": 0}, "frames"),
        ({"rate": 0.0}, "rate"),
        ({"rate": float("nan")}, "rate"),
        ({"speed": -1.0}, "speed"),
        ({"seed": -1}, "seed"),
        ({"depth": (2.0, -1.0)}, "depth"),
        ({"depth": (2.0, 1e9)}, "11000 m"),
        ({"depth": (2.0, 3000.0)}, "no daylight .* 3000 m"),
        ({"depth": (2.0, 11e3), "water_effects": WaterEffects(water_type="3C")}, "no daylight"),
        ({"attenuation": (-0.1, 0.3)}, "mean attenuation"),
    ],
)
def test_what_cannot_be_swum_is_refused(arguments: dict[str, object], what: str) -> None:
    with pytest.raises(InputError, match=what):
        Transect(**arguments)  # type: ignore[arg-type]
