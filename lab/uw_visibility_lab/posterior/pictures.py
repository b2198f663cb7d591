# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Seams, noise, colour errors and flicker of enhanced pictures, by our method and others.

Real pairs have no ground truth. Traced views have it; their right images are warped left ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.commands.calibration_file import read_rig
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Image8, RangeMap
from uw_visibility.images.cells import means
from uw_visibility.images.files import read_image
from uw_visibility.images.noise import BLOCK, SMOOTHEST
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.stereo.views import in_right_view
from uw_visibility.water.series.filter import WaterFilter
from uw_visibility_lab.evaluation import baselines
from uw_visibility_lab.evaluation.metrics import at_best_exposure, colour_difference
from uw_visibility_lab.posterior.cases import traced_scenes
from uw_visibility_lab.tracer.files import load

# Quantile of the gain's steps that is shown.
QUANTILE = 0.99
# Period of the frames, s.
_PERIOD = 0.1


class Pair(NamedTuple):
    """A pair to enhance, with ranges, (H, W), m, and the scene without water if they are known."""

    name: str
    left: Image8
    right: Image8
    rig: StereoRig
    ranges: RangeMap | None = None
    truth: Image8 | None = None


class Row(NamedTuple):
    """Figures of one method's picture; NaN where they do not apply."""

    method: str
    steps: Array  # of the gain between neighbours, codes
    wide_steps: Array  # the same between pixels that are a block apart
    noise: float  # of flat areas, relative to the raw picture
    colour: float  # mean ΔE*ab to the truth at the best exposure, where ranges are known
    flicker: float  # change of blocks' means between frames that differ by noise, codes


def gain_steps(raw: Image8, enhanced: Image8, distance: int = 1) -> Array:
    """Steps of the gain where the raw picture has none, codes.

    Pixels with the same raw values in all channels differ in the enhanced picture by the gain
    only. Pixels `distance` px apart along rows and columns are compared.
    """
    steps = []
    for axis in (0, 1):
        before, after = (
            tuple(part if a == axis else slice(None) for a in (0, 1))
            for part in (slice(None, -distance), slice(distance, None)))
        alike = (raw[before] == raw[after]).all(axis=-1)
        steps.append(np.abs(
            enhanced[before][alike].astype(int) - enhanced[after][alike]).max(axis=-1))
    return np.concatenate(steps).astype(np.float64)


def noise_ratio(raw: Image8, enhanced: Image8) -> float:
    """RMS noise of the flattest blocks relative to the raw picture, of the channels' mean.

    Noise is the deviation from the mean of the four neighbours; uniform blocks are left out.
    """
    before, after = (_block_noise(image) for image in (raw, enhanced))
    if not (before > 0).any():
        return float("nan")
    flat = (before > 0) & (before <= np.quantile(before[before > 0], SMOOTHEST))
    return float(np.sqrt(after[flat].sum() / before[flat].sum()))


def _block_noise(image: Image8) -> Array:
    kernel = np.array([[0, -1, 0], [-1, 4, -1], [0, -1, 0]]) / 4
    return means(cv2.filter2D(image.astype(np.float64).mean(axis=-1), -1, kernel) ** 2, BLOCK)


def _change(first: Image8, second: Image8) -> float:
    """Root mean square change of the means of blocks, codes."""
    return float(np.sqrt(np.mean(means(first.astype(float) - second, BLOCK) ** 2)))


def with_noise(image: Image8, seed: tuple[int, ...]) -> Image8:
    """Return an image with added noise of one code, like another frame of the same scene."""
    noise = np.random.default_rng(seed).integers(-1, 2, image.shape)
    return np.clip(image.astype(int) + noise, 0, 255).astype(np.uint8)


def real_pairs(folder: Path) -> Iterator[Pair]:
    """Yield the pairs of a folder with calibration.json, left_*.png and right_*.png."""
    found = sorted(folder.glob("left_*.png"))
    if not found:
        raise InputError(f"{folder} holds no pairs: give left_*.png, right_*.png, calibration.json")
    rig, _ = read_rig([folder / "calibration.json"])
    for path in found:
        right = path.with_name(path.name.replace("left", "right", 1))
        name = f"{folder.name} {path.stem.removeprefix('left_')}"
        yield Pair(name, read_image(path), read_image(right), rig)


def traced_pairs(folder: Path) -> Iterator[Pair]:
    """Yield traced scenes as recorded by 8-bit linear cameras with noise of one code.

    The right image is warped from the left one by its ranges; open water is at infinity.
    """
    for index, place in enumerate(traced_scenes(folder)):
        scene = load(place)
        height, width = scene.ranges.shape
        rig = StereoRig(
            scene.focal_length, scene.baseline, ((width - 1) / 2, (height - 1) / 2))
        disparity = np.nan_to_num(rig.disparity_from_range(scene.ranges.astype(np.float32)))
        y, x = np.indices(disparity.shape, np.float32)
        seen = cv2.remap(
            scene.image.astype(np.float32), x + in_right_view(disparity), y, cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE)
        rng = np.random.default_rng(index)
        left, right = (
            np.clip(np.rint(255.0 * i + rng.normal(0.0, 1.0, i.shape)), 0, 255).astype(np.uint8)
            for i in (scene.image, seen))
        truth = np.rint(255.0 * np.clip(scene.surface / scene.light, 0, 1)).astype(np.uint8)
        yield Pair(place.name, left, right, rig, scene.ranges.astype(np.float32), truth)


def enhance(pair: Pair, pipeline: Pipeline, series: WaterFilter, stamp: float) -> dict[str, Image8]:
    """Return the left picture by each method; Sea-thru only with known ranges.

    Ours is that of a frame at a stamp (s) of a recording, after those that `series` has seen.
    """
    known = series.known
    ours = pipeline.process(
        pair.left, pair.right, enhance=("left",), known_water=lambda: known and known.at(stamp))
    series.update(ours.water, stamp)
    pictures: dict[str, NDArray[np.generic]] = {
        "raw": pair.left,
        "ours": ours.left_enhanced,
        "CLAHE": baselines.equalise_adaptively(pair.left),
        "grey world": baselines.balance_by_grey_world(pair.left),
    }
    if pair.ranges is not None:
        pictures["Sea-thru"] = baselines.sea_thru(pair.left, pair.ranges)
    return {name: np.asarray(image, np.uint8) for name, image in pictures.items()}


def compare(pair: Pair, config: PipelineConfig, seed: int = 0) -> list[Row]:
    """Measure each method's picture of a pair."""
    pipeline, series = Pipeline(pair.rig, config), WaterFilter(config)
    first = enhance(pair, pipeline, series, 0.0)
    following = pair._replace(
        left=with_noise(pair.left, (seed, 0)), right=with_noise(pair.right, (seed, 1)))
    other = enhance(following, pipeline, series, _PERIOD)
    rows = []
    for name, picture in first.items():
        rows.append(Row(
            name, gain_steps(pair.left, picture), gain_steps(pair.left, picture, BLOCK),
            noise_ratio(pair.left, picture), _colour(picture, pair), _change(picture, other[name])))
    return rows


def _colour(picture: Image8, pair: Pair) -> float:
    """Mean ΔE*ab to the scene without water, at the picture's best exposure; NaN without truth.

    No method can tell bright surfaces in dim light from dark ones in bright light.
    """
    if pair.truth is None or pair.ranges is None:
        return float("nan")
    known = np.isfinite(pair.ranges)
    seen, truth = (image[known][np.newaxis] for image in (picture, pair.truth))
    (scaled,) = at_best_exposure([seen.astype(np.float32)], [truth.astype(np.float32)])
    codes = np.clip(np.rint(scaled), 0, 255).astype(np.uint8)
    return float(colour_difference(codes, truth).mean())


def summary(rows: Sequence[Row]) -> list[Row]:
    """Return a row for each method: steps of all pictures together, medians of the rest."""
    methods = dict.fromkeys(row.method for row in rows)
    return [
        Row(
            method, np.concatenate([row.steps for row in of_it]),
            np.concatenate([row.wide_steps for row in of_it]),
            *(float(np.nanmedian(values)) if np.isfinite(values).any() else float("nan")
              for values in np.array([row[3:] for row in of_it]).T))
        for method in methods for of_it in [[row for row in rows if row.method == method]]]


HEAD = (
    f"{'picture':16} {'method':10} {'step':>5} {'8 px':>5} {'noise':>5} {'ΔE':>5} {'flicker':>7}")


def line_of(name: str, row: Row) -> str:
    """Return a row as a line below `HEAD`, steps as their quantile `QUANTILE`."""
    steps, wide = (
        np.quantile(values, QUANTILE) if values.size else float("nan")
        for values in (row.steps, row.wide_steps))
    return (
        f"{name[:16]:16} {row.method:10} {steps:5.1f} {wide:5.1f} {row.noise:5.2f} "
        f"{row.colour:5.1f} {row.flicker:7.2f}")
