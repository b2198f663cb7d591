# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Cases of the judge: the same in every run, with the truth they were made with."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.posterior.cases import drawn, halves, sea, traced
from uw_visibility_lab.posterior.examples import draw_all, load, save
from uw_visibility_lab.posterior.judge import Case, OnBoard
from uw_visibility_lab.worlds.scenes import load_scene, make_pool
from uw_visibility_lab.worlds.scenes import pool as scenes_of

SEA = Path(__file__).resolve().parents[4] / "shared" / "data" / "flsea"


@pytest.fixture(scope="module")
def pool(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pool")
    make_pool(3, 1, folder, size=(96, 128))
    return folder


def test_views_of_examples_are_the_same_for_any_number_of_jobs(pool: Path, tmp_path: Path) -> None:
    one, two = (draw_all(pool, 30, 7, jobs, lambda done, _: done) for jobs in (1, 2))
    assert 15 < len(one.truth) <= 30
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)
    # ln (B/W) is the same in units of the image and in those of the scene.
    assert np.isfinite(one.truth).all()
    save(one, tmp_path / "views.npz")
    np.testing.assert_array_equal(load(tmp_path / "views.npz").truth, one.truth)


def test_files_that_hold_no_views_are_one_sentence(tmp_path: Path) -> None:
    np.savez(tmp_path / "views.npz", a=np.zeros(3))
    with pytest.raises(InputError, match="no statistics of views"):
        load(tmp_path / "views.npz")
    with pytest.raises(InputError, match="no traced scenes"):
        next(iter(traced(tmp_path)))
    with pytest.raises(InputError, match="no frames"):
        next(iter(sea(tmp_path)))


def test_todays_estimator_answers_clear_cases() -> None:
    """A floor with black and white patches, in water that is lit as the scene is."""
    rng = np.random.default_rng(3)
    ranges = np.repeat(np.geomspace(6.0, 1.5, 240)[:, np.newaxis], 320, axis=1)
    patches = cv2.resize(
        rng.choice((0.0, 0.9), (60, 80)), (320, 240), interpolation=cv2.INTER_NEAREST)
    attenuation = np.array((0.4, 0.25, 0.2))
    left = np.exp(-attenuation * ranges[..., np.newaxis])
    image = 0.8 * (patches[..., np.newaxis] * left + (1.0 - left))
    case = Case(
        (image * 255).astype(np.uint8), ranges.astype(np.float32), 0.0, "linear",
        np.array((0.228, 0.066, 0.0245)), attenuation)
    answer = OnBoard("paper")(case)
    assert answer.told
    off = answer.log_attenuation - np.log(attenuation)
    assert (np.abs(off) < 0.3).all() and (np.abs(off) < 3.0 * answer.stddev).all()
    assert answer.log_distance == -answer.log_attenuation.min()
    dark = OnBoard()(Case(
        np.zeros_like(case.image), case.ranges, 0.0, "linear", case.clear_water, attenuation))
    assert not dark.told and dark.status == "too dark"


@pytest.mark.skipif(not SEA.is_dir(), reason="the frames of FLSea are not there")
def test_halves_of_a_frame_of_the_sea_make_the_whole() -> None:
    case = next(iter(sea(SEA)))
    left, right = halves(case)
    assert (left.name, right.name) == (f"{case.name} left", f"{case.name} right")
    np.testing.assert_array_equal(np.concatenate((left.image, right.image), axis=1), case.image)
    np.testing.assert_array_equal(np.concatenate((left.ranges, right.ranges), axis=1), case.ranges)
    # Lines of sight are longer than Z.
    z = cv2.imread(str(SEA / "0000_depth.png"), cv2.IMREAD_UNCHANGED) / 1000.0
    assert (case.ranges[z > 0] >= z[z > 0] - 1e-4).all()
    assert case.ranges[z > 0].max() < 1.2 * z.max()


def test_drawn_cases_repeat(pool: Path) -> None:
    scenes = [load_scene(path) for path in scenes_of(pool)]
    first, second = list(drawn(scenes, 4, 1)), list(drawn(scenes, 4, 1))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.image, b.image)
    assert any((a.image != b.image).any() for a, b in zip(first, drawn(scenes, 4, 2), strict=True))
