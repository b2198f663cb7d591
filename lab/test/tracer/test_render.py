# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Traced light against closed forms, at a few pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import trapezoid

from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError
from uw_visibility_lab.simulation.camera import Pose
from uw_visibility_lab.simulation.raycast import on_floor
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.view import look
from uw_visibility_lab.tracer.files import load
from uw_visibility_lab.tracer.render import (
    Geometry,
    fournier_forand_table,
    image_guide,
    without_gaps,
)
from uw_visibility_lab.tracer.scene import camera_of, draw_scene


def test_the_table_of_a_phase_function_integrates_to_one_and_keeps_the_mean_cosine() -> None:
    table = fournier_forand_table(1 << 15)
    step = 2.0 / (len(table) - 1)
    whole = 2.0 * np.pi * step * (table.sum() - 0.5 * (table[0] + table[-1]))
    assert whole == pytest.approx(1.0, abs=0.01)
    along = np.linspace(-1.0, 1.0, len(table))
    mean = trapezoid(table * along, along) / trapezoid(table, along)
    assert mean == pytest.approx(0.930, abs=0.005)


def test_a_pixel_that_is_no_number_takes_those_around() -> None:
    image = np.ones((8, 20, 3), np.float32)
    image[3, 4, 1] = np.nan
    filled = without_gaps(image)
    assert (filled == 1.0).all()
    assert np.isnan(image[3, 4, 1])


def test_an_image_full_of_gaps_is_refused() -> None:
    with pytest.raises(InputError, match="not finite"):
        without_gaps(np.full((4, 4, 3), np.inf, np.float32))


def test_guides_show_nothing_that_water_hides() -> None:
    description = draw_scene(2, "reef")
    ranges = np.array([[1.0, 40.0, np.nan]], np.float32)
    geometry = Geometry(ranges, np.ones((1, 3, 3)), np.zeros((1, 3, 3)))
    guide = image_guide(np.ones((1, 3, 3)), geometry, description)
    assert guide[0, 0].min() > 0.9
    assert guide[0, 1].max() < 1e-3
    assert (guide[0, 2] == 0.0).all()


@pytest.fixture(scope="module")
def tracer():
    """Return a traced scene in water that only absorbs."""
    pytest.importorskip("mitsuba", reason="needs the lab's extra trace")
    from uw_visibility_lab.tracer.render import Tracer
    from uw_visibility_lab.tracer.scene import Description, Water

    water = Water((0.3, 0.1, 0.05), (1e-9, 1e-9, 1e-9))
    return Tracer(Description("boulders", 2, water, 5.0, 1.8, 40.0), 32, 24, threads=1)


def test_without_scattering_light_falls_by_absorption(tracer) -> None:
    seen = tracer.radiance(128)
    bare = tracer.radiance(128, through_water=False)
    ranges = tracer.geometry(4).ranges[..., None]
    near = np.isfinite(ranges[..., 0])
    expected = bare * np.exp(-np.array([0.3, 0.1, 0.05]) * ranges)
    # Noise of 100,000 paths is below 1 %; ranges that differ within a pixel are left.
    ratio = seen[near].sum(axis=0) / expected[near].sum(axis=0)
    assert ratio == pytest.approx(1.0, abs=0.03)


def test_black_surfaces_leave_no_light_where_nothing_scatters(tracer) -> None:
    assert tracer.radiance(4, black=True).max() < 1e-6


def test_ranges_are_those_of_the_ray_caster_over_the_same_reef(tracer) -> None:
    geometry, scene = tracer.geometry(4), reef(2, 0.0, boulders=0.25, corals=0.0)
    above = 1.8 + on_floor(scene, scene.heights, 0.0, 0.0)
    pose = Pose((0.0, 0.0, above), tilt=np.radians(40.0))
    cast = look(scene, camera_of(32, 24), pose, Workers(1)).range
    off = np.abs(geometry.ranges / cast - 1.0)
    assert np.median(off) < 0.002
    # Others have an edge within.
    assert np.quantile(off, 0.9) < 0.03
    assert (geometry.reflectance > 0.0).mean() > 0.99


def test_a_series_is_taken_up_where_it_ended(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba", reason="needs the lab's extra trace")
    pytest.importorskip("pyoidn", reason="needs the lab's extra trace")
    from uw_visibility_lab.tracer.render import render_scene

    folder, description = tmp_path / "00002_boulders", draw_scene(2, "boulders")
    assert render_scene(folder, description, (64, 48), 4, threads=1)
    assert not render_scene(folder, description, (64, 48), 4, threads=1)
    left = load(folder)
    assert left.image.shape == (48, 64, 3)
    assert left.truth["description"]["seed"] == 2
