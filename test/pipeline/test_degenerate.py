# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Degenerate pictures and real frames: no failure, no warning, nothing absurd said to be ok."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from degenerate import Picture, absurdity, examine, pictures
from hypothesis import given, settings

from uw_visibility import Pipeline, PipelineConfig, StereoRig, estimate_water, match
from uw_visibility.errors import InputError


@given(picture=pictures())
@settings(max_examples=25)
def test_degenerate_pictures(picture: Picture) -> None:
    examine(picture)


def test_a_large_picture_without_red() -> None:
    """Of this size and with open water, a channel of zeros became an index of a table."""
    examine(Picture(
        881, 1377, 8, False, "linear", "texture", 0.1, 0.5, ("red 0",), "", 3))


@pytest.mark.parametrize(("seed", "largest"), [(25092, 320), (25348, 320), (28859, 1500)])
def test_pictures_that_the_fuzzer_found(seed: int, largest: int) -> None:
    """Open water of code 0 in a channel with light, and light that no transmission leaves."""
    examine(Picture.random(seed, largest))


def test_matching_of_degenerate_pairs() -> None:
    for seed in range(12):
        picture = Picture.random(seed)
        left, right, _ = picture.make()
        try:
            stereo = match(left, right, picture.rig)
        except InputError:
            continue
        assert not np.isinf(stereo.disparity).any()
        assert (stereo.range[np.isfinite(stereo.disparity)] > 0).all()


def real_frames(folder: Path) -> list[Path]:
    return sorted(
        file for file in (folder / "real_frames").iterdir()
        if file.suffix.lower() in (".jpg", ".jpeg", ".png"))


@pytest.mark.parametrize(("transfer", "red"), [("linear", True), ("srgb", False)])
def test_real_frames_with_a_plane_set_beside_them(
    shared_data: Path, transfer: str, red: bool
) -> None:
    """Nothing of the plane is true, but nothing may fail, or be absurd and ok."""
    files = real_frames(shared_data)
    assert len(files) > 5
    for file in files:
        image = cv2.imread(str(file))[..., ::-1]
        width = 320
        size = width, round(width * image.shape[0] / image.shape[1])
        image = np.ascontiguousarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        if not red:
            image[..., 0] = 0
        rows = np.linspace(5.0, 27.0, size[1])
        rig = StereoRig(270.0, 0.12, ((width - 1) / 2, (size[1] - 1) / 2))
        config = PipelineConfig.from_parameters({"camera.transfer": transfer})
        disparity = np.repeat(rows[:, np.newaxis], width, 1).astype(np.float32)
        found = estimate_water(image, disparity, rig, config)
        clear = found.clear_water_attenuation
        assert absurdity(found.water, found.visibility, clear) == "", file.name
        columns = np.arange(width)[np.newaxis] + rows[:, np.newaxis]
        right = cv2.remap(
            image, columns.astype(np.float32),
            np.repeat(np.arange(size[1], dtype=np.float32)[:, np.newaxis], width, 1),
            cv2.INTER_LINEAR)
        result = Pipeline(rig, config).process(image, right)
        assert absurdity(result.water, result.visibility, clear) == "", file.name


@pytest.mark.parametrize("red", [True, False])
def test_a_real_pair_that_is_neither_rectified_nor_calibrated(
    shared_data: Path, red: bool
) -> None:
    """At full size, where a channel of zeros ended the process."""
    left, right = (
        np.ascontiguousarray(
            cv2.imread(str(shared_data / "real_frames" / f"flsea_000006_{side}.png"))[..., ::-1])
        for side in "LR")
    if not red:
        left[..., 0] = right[..., 0] = 0
    centre = (left.shape[1] - 1) / 2, (left.shape[0] - 1) / 2
    result = Pipeline(StereoRig(1300.0, 0.25, centre)).process(left, right)
    assert absurdity(result.water, result.visibility, result.clear_water_attenuation) == ""
    assert result.left_enhanced.shape == left.shape
