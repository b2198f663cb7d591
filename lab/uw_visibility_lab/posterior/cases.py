# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Test cases of estimators: drawn views, path-traced scenes, frames of the sea."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.images.files import read_image
from uw_visibility.stereo.rig import StereoRig
from uw_visibility_lab.posterior.judge import Case, LampCase
from uw_visibility_lab.simulation.water import CLEAR_WATER
from uw_visibility_lab.tracer.files import TRUTH
from uw_visibility_lab.tracer.files import load as load_traced
from uw_visibility_lab.worlds.draw import draw
from uw_visibility_lab.worlds.night import draw_night
from uw_visibility_lab.worlds.scenes import Scene

# Of FLSea's camera, px (README of the data); 10 % more or less changes ranges by less than 2 %.
SEA_FOCAL_LENGTH = 1296.0


def drawn(
    scenes: Sequence[Scene], number: int, seed: int, effects: Sequence[str] | None = None
) -> Iterator[Case]:
    """Draw views of the scenes in turn, each with its own seed."""
    for index in range(number):
        scene = scenes[index % len(scenes)]
        view = draw(np.random.default_rng((seed, index)), scene, effects=effects)
        yield Case(
            view.image, view.ranges, view.range_error, view.transfer, view.clear_water,
            view.attenuation, scene.name)


def by_lamps(
    scenes: Sequence[Scene], number: int, seed: int, effects: Sequence[str] | None = None,
    daylight: float | None = None, contrast: float = 1.0,
) -> Iterator[LampCase]:
    """Draw frames of the scenes under lamps in turn; see `draw_night`."""
    for index in range(number):
        scene = scenes[index % len(scenes)]
        night = draw_night(
            np.random.default_rng((seed, index)), scene, effects, daylight, contrast)
        config = PipelineConfig.from_parameters(night.lighting)
        yield LampCase(
            night.image, night.ranges, night.range_error, "linear", night.clear_water,
            night.attenuation, scene.name, config.lighting,
            night.focal_length * night.image.shape[1])


def traced(folder: Path, seed: int = 0) -> Iterator[Case]:
    """Path-traced scenes as recorded by an 8-bit linear camera with a noise of one code."""
    for index, place in enumerate(traced_scenes(folder)):
        scene = load_traced(place)
        noise = np.random.default_rng((seed, index)).normal(0.0, 1.0, scene.image.shape)
        codes = np.clip(np.rint(scene.image * 255.0 + noise), 0, 255).astype(np.uint8)
        yield Case(
            codes, scene.ranges.astype(np.float32), 0.0, "linear", CLEAR_WATER, scene.attenuation,
            place.name)


def traced_scenes(folder: Path) -> list[Path]:
    """Return the folders of complete scenes that `uw_visibility render` made."""
    found = sorted(path.parent for path in folder.glob(f"*/{TRUTH}"))
    if not found:
        raise InputError(f"{folder} holds no traced scenes: make some by uw_visibility render")
    return found


def sea(folder: Path) -> Iterator[Case]:
    """Frames of FLSea with their ranges; their water is not known."""
    frames = sorted(folder.glob("[0-9][0-9][0-9][0-9].png"))
    if not frames:
        raise InputError(f"{folder} holds no frames: give the folder with NNNN.png, NNNN_depth.png")
    for path in frames:
        image, z = read_image(path), read_image(path.with_name(f"{path.stem}_depth.png"))
        if z.ndim != 2:
            raise InputError(f"the depth of {path} has several channels: give Z in mm alone")
        height, width = z.shape
        rig = StereoRig(SEA_FOCAL_LENGTH, 1.0, ((width - 1) / 2, (height - 1) / 2))
        along_the_ray = z.astype(np.float32) / 1000.0 * rig.ray_lengths(z.shape)
        yield Case(
            image, np.where(z > 0, along_the_ray, np.float32(np.nan)), 0.0, "linear",
            CLEAR_WATER, None, path.stem)


def halves(case: Case) -> tuple[Case, Case]:
    """Return the left and the right half of a case, which show the same water."""
    middle = case.image.shape[1] // 2
    left, right = (
        replace(
            case, image=np.ascontiguousarray(case.image[:, columns]),
            ranges=np.ascontiguousarray(case.ranges[:, columns]), name=f"{case.name} {name}")
        for name, columns in (("left", np.s_[:middle]), ("right", np.s_[middle:])))
    return left, right
