# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Training examples of the posterior: statistics of random views, with ground truth."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.files import write_whole
from uw_visibility.errors import InputError
from uw_visibility.images.view import View as CameraView
from uw_visibility.water.blocks import BLOCKS_KEPT, Blocks, reduce_to_blocks, stacked, thinned
from uw_visibility.water.daylight.statistics import (
    BINS,
    OF_BIN,
    OF_IMAGE,
    Statistics,
    summarise,
)
from uw_visibility_lab.evaluation.parallel import Progress, run_all
from uw_visibility_lab.worlds.beliefs import bounds, count, happens
from uw_visibility_lab.worlds.beliefs import draw as belief
from uw_visibility_lab.worlds.draw import View, draw
from uw_visibility_lab.worlds.scenes import load_scene
from uw_visibility_lab.worlds.scenes import pool as scenes_of

# Number of views that a process draws at a time.
BLOCK = 100


class Examples(NamedTuple):
    """Statistics and truth of N views, float32."""

    of_bins: NDArray[np.float32]  # (N, 3, BINS, OF_BIN)
    of_tiles: NDArray[np.float32]  # (N, 5, TILES, BINS)
    of_channels: NDArray[np.float32]  # (N, 3, OF_CHANNEL)
    of_image: NDArray[np.float32]  # (N, OF_IMAGE)
    truth: NDArray[np.float32]  # (N, 3, 3); ln βd̃, ln B/b̂, ln W/b̂ by channel: see `network`
    # (N,); whether the camera's curve differs from the declared one
    other_curve: NDArray[np.bool_]
    # (N,); whether lamps light the view instead of daylight: then veil and light have no truth
    lamps: NDArray[np.bool_]


def blocks_of(view: View) -> Blocks:
    """Blocks of a drawn view, as in the estimator."""
    samples = CameraView.of(view.image, view.transfer).colour
    assert samples is not None
    return reduce_to_blocks(samples, view.ranges, None)


def statistics_of(view: View) -> Statistics | None:
    """Statistics of a drawn view, as in the estimator."""
    return summarise(blocks_of(view), view.range_error, view.clear_water)


def statistics_of_survey(rng: np.random.Generator, views: Sequence[View]) -> Statistics | None:
    """Statistics of several frames as of one image, at the exposure of the first."""
    blocks = [
        (thinned(blocks_of(view), BLOCKS_KEPT),
         views[0].light / view.light * belief(rng, "survey.gain_error")) for view in views]
    return summarise(stacked(blocks), views[0].range_error, views[0].clear_water)


def truth_of(view: View, statistics: Statistics) -> NDArray[np.float32]:
    """Unknowns of each channel in the units of the statistics, (3, 3)."""
    return np.log(np.stack((
        view.attenuation * statistics.median_range, view.veil / statistics.brightest,
        view.light / statistics.brightest), axis=1)).astype(np.float32)


def draw_all(
    pool: Path, number: int, seed: int, jobs: int, progress: Progress,
    lamps: float | None = None,
) -> Examples:
    """Draw views and reduce them to statistics; the result does not depend on `jobs`.

    `lamps` is the share of views under lamps, by default that of the beliefs. Views with too few
    ranges, or whose truth has no finite logarithm, are left out.
    """
    places = scenes_of(pool)
    blocks = [range(at, min(at + BLOCK, number)) for at in range(0, number, BLOCK)]
    draw_block = partial(_draw_block, places=places, seed=seed, share=lamps)
    rows = [row for block in run_all(draw_block, blocks, jobs, progress) for row in block]
    if len(rows) < 0.5 * number:
        raise InputError(
            f"{number - len(rows)} of {number} views of {pool} show too little: check the scenes")
    statistics, truth, other_curve, lit = zip(*rows, strict=True)
    of_bins, of_tiles, of_channels, of_image, *_ = zip(*statistics, strict=True)
    return Examples(
        np.stack(of_bins), np.stack(of_tiles), np.stack(of_channels), np.stack(of_image),
        np.stack(truth), np.array(other_curve), np.array(lit))


def _draw_block(
    block: range, places: Sequence[Path], seed: int, share: float | None
) -> list[tuple[Statistics, NDArray[np.float32], bool, bool]]:
    """Return statistics and truth of each view, and the flags of `Examples`."""
    share = bounds("lamps.share")[0] if share is None else share
    rows = []
    for index in block:
        rng = np.random.default_rng((seed, index, 0))
        frames = count(rng, "survey.frames") if happens(rng, "survey.share") else 1
        lamps = frames == 1 and rng.random() < share
        views = [_frame(places, (seed, index), k, lamps) for k in range(frames)]
        statistics = statistics_of(views[0]) if frames == 1 else statistics_of_survey(rng, views)
        if statistics is None:
            continue
        truth = truth_of(views[0], statistics)
        # The effective β differs with the ranges in view: the truth is the mean over the frames.
        truth[:, 0] += np.mean(
            [np.log(view.attenuation / views[0].attenuation) for view in views], axis=0)
        if np.isfinite(truth).all():
            rows.append((statistics, truth, "foreign curve" in views[0].effects, lamps))
    return rows


def _frame(
    places: Sequence[Path], seed: tuple[int, int], frame: int, lamps: bool
) -> View:
    """Draw a frame of an example; frames share water and camera, but not scenes and ranges."""
    rng = np.random.default_rng(seed)
    first = int(rng.integers(len(places)))
    if frame == 0:
        return draw(rng, load_scene(places[first]), lamps=lamps)
    other = np.random.default_rng((*seed, 1, frame))
    scene = load_scene(places[int(other.integers(len(places)))])
    return draw(rng, scene, nearer=belief(other, "survey.nearer"))


def joined(first: Examples, second: Examples) -> Examples:
    """Concatenate examples."""
    return Examples(*(np.concatenate(each) for each in zip(first, second, strict=True)))


def save(examples: Examples, path: Path) -> None:
    """Write examples to an .npz file."""
    content = io.BytesIO()
    np.savez(content, **examples._asdict())  # type: ignore[arg-type]
    write_whole(path, content.getvalue())


def load(path: Path) -> Examples:
    """Read what `save` wrote."""
    try:
        with np.load(path, allow_pickle=False) as data:
            found = Examples(*(data[name] for name in Examples._fields))
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} holds no statistics of views: draw them anew") from error
    if found.of_bins.shape[1:] != (3, BINS, OF_BIN) or found.of_image.shape[1:] != (OF_IMAGE,):
        raise InputError(f"{path} holds statistics of another form: draw them anew")
    return found
