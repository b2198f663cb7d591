# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Scenes as folders: what is written is read again, and what is damaged is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.tracer.files import (
    exposure,
    load,
    truth_of,
    write_truth,
    write_view,
)
from uw_visibility_lab.tracer.scene import draw_scene


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Return a folder with a scene of plain arithmetic instead of traced light."""
    random = np.random.default_rng(3)
    description = draw_scene(5, "reef")
    ranges = np.broadcast_to(np.linspace(6.0, 1.0, 90)[:, None], (90, 120)).astype(np.float32)
    ranges = ranges.copy()
    ranges[:6] = np.nan
    reflectance = random.uniform(0.1, 0.6, (90, 120, 3)).astype(np.float32)
    surface = 0.8 * reflectance
    far = np.where(np.isfinite(ranges), ranges, 1e3)[..., None]
    black = 0.3 * (1.0 - np.exp(-0.2 * far)) * np.ones(3)
    image = np.where(far < 1e3, surface * np.exp(-0.2 * far), 0.0) + black
    arrays = {"image": image, "raw": image, "raw_black": black, "surface": surface,
              "ranges": ranges, "reflectance": reflectance}
    write_view(tmp_path, arrays)
    write_truth(tmp_path, truth_of(description, StereoCamera(120, 90, 100.0), 1.0, 16, arrays))
    return tmp_path


def test_a_scene_is_read_as_it_was_written(scene: Path) -> None:
    traced = load(scene)
    truth = traced.truth
    assert (truth["description"]["kind"], truth["description"]["seed"]) == ("reef", 5)
    assert traced.image.shape == (90, 120, 3)
    assert traced.image.dtype == traced.ranges.dtype == np.float32
    assert np.isnan(traced.ranges[:6]).all()
    assert traced.attenuation == pytest.approx(0.2, rel=0.02)
    assert truth["veil"] == pytest.approx([0.3] * 3, abs=0.001)
    assert traced.light == pytest.approx(0.8, rel=0.01)
    assert np.add(truth["absorption"], truth["scattering"]) == pytest.approx(
        truth["beam_attenuation"])


def test_a_folder_without_truth_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="uw_visibility render"):
        load(tmp_path)


def test_damaged_files_are_refused(scene: Path) -> None:
    (scene / "left.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"left\.png"):
        load(scene)
    (scene / "truth.json").write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match="'attenuation'"):
        load(scene)


def test_exposure_brings_the_brightest_hundredth_to_nine_tenths() -> None:
    image = np.zeros((10, 100, 3))
    image[..., 1] = np.linspace(0.0, 2.0, 1000).reshape(10, 100)
    assert np.quantile(image.max(axis=-1) * exposure(image), 0.99) == pytest.approx(0.9)
