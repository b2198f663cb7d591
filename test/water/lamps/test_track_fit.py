# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Attenuation from the ratios of the light of tracked points, by known lamps."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from lamp_floor import BETA, LIGHTING, sightings

from uw_visibility.water.lamps.track_fit import TrackFit, fit_tracks
from uw_visibility.water.lamps.tracks import Sightings, observe_points


def _part(seen: Sightings, number: int) -> Sightings:
    """The first so many sightings."""
    return Sightings(*(getattr(seen, field.name)[:number] for field in fields(Sightings)))


def _off(fit: TrackFit) -> np.ndarray:
    """Errors of ln β."""
    return np.asarray(fit.log_attenuation - np.log(BETA))


@pytest.mark.parametrize("exponent", [0.0, 1.0])
def test_attenuation_does_not_depend_on_what_the_ground_reflects(exponent: float) -> None:
    # No light by the water, which the fit expects about: it is told apart by the points.
    even = fit_tracks(sightings(exponent), LIGHTING, 0.0)
    sloping = fit_tracks(sightings(exponent, brighter=0.5), LIGHTING, 0.0)
    for fit in (even, sloping):
        assert fit is not None
        deviation, off = np.sqrt(np.diag(fit.covariance)), _off(fit)
        assert (np.abs(off) < 2 * deviation).all(), off
        assert (np.abs(off) < 0.12).all(), off


def test_light_of_a_patch_falls_off_to_its_sides() -> None:
    # One lamp beside the camera: the nearer, the more the middle of a patch outshines its rim.
    lamp = replace(
        LIGHTING, positions=(0.1, 0.0, 0.0), directions=(0.0, 0.0, 1.0), beam_angles=(80.0,),
        colours=(1.0, 1.0, 1.0))
    seen = []
    for k in range(20):
        altitude = 0.6 + 0.1 * k
        at = np.linspace(-0.16, 0.16, 41)
        y, x = np.meshgrid(at, at)
        r = np.sqrt((x - 0.1)**2 + y**2 + altitude**2)
        path = r + np.sqrt(x**2 + y**2 + altitude**2)
        theta = np.degrees(np.arccos(altitude / r))
        lit = np.exp(-math.log(2) * (2 * theta / 80.0) ** 2) / r**2 * (altitude / r)
        light = np.array([(lit * np.exp(-beta * path)).mean() for beta in BETA])
        number = np.arange(40)
        seen.append(Sightings(
            np.outer(0.02 * (1 + number), light), np.tile([0.0, 0.0, 1.0], (40, 1)),
            np.tile([0.0, 0.0, -1.0], (40, 1)), np.full(40, altitude),
            np.full(40, 0.16 / altitude), number, number % 16))
    whole = fit_tracks(seen, lamp, 0.0)
    middle = fit_tracks([replace(each, spread=0.0 * each.spread) for each in seen], lamp, 0.0)
    assert whole is not None and middle is not None
    off, off_middle = (np.abs(_off(fit)).mean() for fit in (whole, middle))
    assert off < 0.6 * off_middle, (off, off_middle)


def test_lamps_that_may_be_elsewhere_widen_the_covariance() -> None:
    seen = sightings()
    exact = fit_tracks(seen, replace(LIGHTING, position_stddev=0.0, direction_stddev=0.0), 0.0)
    vague = fit_tracks(seen, replace(LIGHTING, position_stddev=0.1, direction_stddev=8.0), 0.0)
    assert exact is not None and vague is not None
    assert (np.diag(vague.covariance) > 1.3 * np.diag(exact.covariance)).all()


def test_errors_of_range_widen_the_covariance() -> None:
    seen = [replace(each, spread=0.08 + 0.0 * each.spread) for each in sightings()]
    # The last one is of a baseline of 3 cm and 100 px: nothing is told, but no NaN either.
    exact, rough, useless = (fit_tracks(seen, LIGHTING, error) for error in (0.0, 0.02, 0.3))
    assert exact is not None and rough is not None and useless is not None
    np.testing.assert_array_equal(rough.log_attenuation, exact.log_attenuation)
    assert (np.diag(rough.covariance) > 1.1 * np.diag(exact.covariance)).all()
    assert (np.diag(useless.covariance) > 4.0).all()


def test_too_few_points_and_power_that_changes_tell_nothing() -> None:
    seen = sightings()
    assert fit_tracks([], LIGHTING, 0.0) is None
    assert fit_tracks(seen[:2], LIGHTING, 0.0) is None
    assert fit_tracks([_part(each, 5) for each in seen], LIGHTING, 0.0) is None
    assert fit_tracks(sightings(power=0.5), LIGHTING, 0.0) is None


def test_points_that_the_water_outshines_do_not_count() -> None:
    # Half of the points are nearly black: what is seen in front of them is the water alone.
    fit = fit_tracks(sightings(outshone=0.5), LIGHTING, 0.0)
    assert fit is not None
    error = _off(fit)
    assert (np.abs(error) < 0.04).all(), error
    assert fit_tracks(sightings(outshone=1.0), LIGHTING, 0.0) is None


def test_light_of_a_point_is_that_of_one_patch_of_ground_at_any_range() -> None:
    height, width, focal = 120, 160, 150.0
    x, y = (np.arange(width) - 79.5) / focal, (np.arange(height) - 59.5) / focal
    rays = np.stack(np.broadcast_arrays(x, y[:, None], 1.0), axis=2)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    for altitude in (1.5, 3.0):
        # A floor whose light rises along the columns, with a saturated corner and a hole.
        along = altitude * x
        light = np.repeat(np.tile(0.3 + 0.1 * along, (height, 1))[..., None], 3, axis=2)
        ranges = (altitude / rays[..., 2]).astype(np.float32)
        ranges[:50, :50] = np.nan
        saturated = np.zeros((height, width), bool)
        saturated[70:, 110:] = True
        points = np.array([[80.2, 60.0], [25.0, 25.0], [130.0, 90.0], [2.0, 60.0]])
        found = observe_points(
            light.astype(np.float32), saturated, ranges, rays, points, np.arange(4))
        np.testing.assert_array_equal(found.track, [0])
        np.testing.assert_allclose(
            found.light[0], 0.3 + 0.1 * altitude * 0.7 / focal, atol=1e-5)
        np.testing.assert_allclose(found.range, altitude, rtol=1e-3)
        np.testing.assert_allclose(found.normal, [[0.0, 0.0, -1.0]], atol=1e-3)
        # The same 0.32 m of it, whatever the altitude.
        np.testing.assert_allclose(found.spread * altitude, 0.16, rtol=0.1)
