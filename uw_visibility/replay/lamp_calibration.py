# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Calibration of lamps from recordings, and its drawing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uw_visibility.compute.threads import Workers
from uw_visibility.config.lighting import Lamp, LightingConfig
from uw_visibility.errors import InputError
from uw_visibility.images.vignetting import FlatFieldCorrection
from uw_visibility.messages.frames import FrameReader, StereoPair
from uw_visibility.optics.transfer import linear_table
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.inputs.stream import InputStream, RecordedFrame
from uw_visibility.replay.progress import progress_bar, tell
from uw_visibility.water.lamps.calibration import LampCalibration, calibrate_lamps
from uw_visibility.water.lamps.tracks import PointTracker, Sightings

# Track numbers reserved for each recording.
TRACKS = 1 << 32
# Start positions of the search, m: beside, above and below the cameras.
ASIDE, ALONG = 0.45, (-0.3, 0.0, 0.3)


def calibrate_lighting(
    bags: Sequence[Path], options: ReplayOptions, lamps: int | None = None
) -> tuple[LampCalibration, int, list[str]]:
    """Find a vehicle's lamps from recordings of ground at many ranges.

    bags: recordings with the same lamps, exposure and water.
    options: parameters, with the lamps to start from, topics, and the part to use.
    lamps: number of lamps, 1, 2 or 4, if the parameters name none.
    Returns the calibration, the number of frames used, and unreadable parts of the recordings.
    """
    lighting = options.pipeline.lighting
    if lamps is None and lighting.model not in ("lamps", "auto"):
        raise InputError(
            "--lighting needs the number of lamps: give --lamps N, or approximate positions with "
            "lighting.model: lamps in --params-file")
    guesses = [list(lighting.lamps())] if lamps is None else rigs(lamps)
    if lamps is not None:
        # The lamps do not change ranges.
        lighting = LightingConfig(
            model="lamps", positions=tuple(v for lamp in guesses[0] for v in lamp.position))
    options = replace(options, pipeline=replace(options.pipeline, lighting=lighting))
    frames: list[Sightings] = []
    damage: list[str] = []
    reasons: Counter[str] = Counter()
    for index, bag in enumerate(bags):
        with BagReader(bag) as reader:
            frames += _sightings(reader, bag, options, reasons, index * TRACKS)
            damage += reader.damage
    if not frames:
        reason = "; ".join(name for name, _ in reasons.most_common(1)) or "there is none"
        raise InputError(f"no stereo frame could be used to calibrate lamps: {reason}")
    tell(f"searching for the lamps in {len(frames)} frames, from {len(guesses)} first guesses")
    return calibrate_lamps(frames, guesses), len(frames), damage


def rigs(count: int) -> list[list[Lamp]]:
    """Return symmetric rigs of 1, 2 or 4 lamps to start from."""
    aside = {
        1: [[(0.0, -ASIDE)], [(0.0, ASIDE)], [(-ASIDE, 0.0)], [(ASIDE, 0.0)]],
        2: [[(-ASIDE, y), (ASIDE, y)] for y in ALONG] + [[(0.0, -ASIDE), (0.0, ASIDE)]],
        4: [[(x, y) for y in (-ASIDE, ASIDE) for x in (-ASIDE, ASIDE)]],
    }
    if count not in aside:
        raise InputError(
            f"--lamps is {count}: give 1, 2 or 4, or the positions of others in --params-file")
    return [
        [Lamp((x, y, 0.0), (0.0, 0.0, 1.0), 90.0, (1.0, 1.0, 1.0)) for x, y in places]
        for places in aside[count]]


def _sightings(
    reader: BagReader, bag: Path, options: ReplayOptions, reasons: Counter[str], first: int
) -> Iterator[Sightings]:
    """Yield the tracked points of usable frames; count the reasons for others."""
    stream = InputStream(reader, options)
    pairs = FrameReader(stream.selection.rectify)
    pipeline: Pipeline | None = None
    tracker = PointTracker(first)
    frames = (event for event in stream.events() if isinstance(event, RecordedFrame))
    for frame in progress_bar(frames, bag.name, stream.expected_frames):
        try:
            pair = pairs.read(frame.messages(reader.deserialize))
            if pipeline is None or pipeline.rig != pair.rig:
                pipeline = Pipeline(pair.rig, options.pipeline)
            yield _observe(pair, pipeline, tracker)
        except InputError as error:
            reasons[str(error)] += 1


def _observe(pair: StereoPair, pipeline: Pipeline, tracker: PointTracker) -> Sightings:
    """Track points of the ground to a frame, and return their light in it."""
    if pair.left.ndim != 3:
        raise InputError("lamps are calibrated from colour images: these are grey")
    result = pipeline.process(
        pair.left, pair.right, valid=pair.valid, enhance=(), confidence=False,
        colour=pair.chroma)
    left, camera = pair.left, pipeline.config.camera
    saturated = (left == np.iinfo(left.dtype).max).any(axis=2)
    centres = (
        pair.rig.principal_point, pair.rig.principal_point_right or pair.rig.principal_point)
    left, _ = FlatFieldCorrection(camera, centres, Workers(1)).correct(left, pair.right)
    irradiance = linear_table(camera.transfer, left.dtype)[left]
    ranges = result.range
    if pair.valid is not None:
        ranges = np.where(pair.valid, ranges, np.float32(np.nan))
    return tracker.observe(
        irradiance, saturated, ranges, pair.rig.ray_directions(ranges.shape))


# Okabe and Ito's blue, and grey.
FOUND, GUESSED = "#0072b2", "#777777"
DPI = 130
# Length of a lamp's axis in the drawing, m.
ARROW = 0.3


def draw_calibration(path: Path, found: LampCalibration) -> None:
    """Draw lamp positions from above and behind, and deviations of the light from the model."""
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    behind, above, light = figure.subplots(1, 3)
    for axes, (i, j), label in ((behind, (0, 1), "down"), (above, (0, 2), "forward")):
        axes.plot(0, 0, "s", color="black")
        axes.annotate("left camera", (0, 0), (4, 6), textcoords="offset points", fontsize=8)
        for k, (lamp, stddev) in enumerate(zip(found.lamps, found.position_stddev, strict=True)):
            place, axis = np.array(lamp.position), np.array(lamp.direction)
            axes.errorbar(
                place[i], place[j], stddev[j], stddev[i], "o", color=FOUND, capsize=3)
            axes.annotate(
                "", (place[i] + ARROW * axis[i], place[j] + ARROW * axis[j]), (place[i], place[j]),
                arrowprops={"arrowstyle": "->", "color": FOUND})
            axes.annotate(f"lamp {k + 1}", place[[i, j]], (5, -12), textcoords="offset points")
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.3)
        axes.set_xlabel("right [m]")
        axes.set_ylabel(f"{label} [m]")
        axes.grid(alpha=0.25)
    behind.invert_yaxis()
    behind.set_title("view of the camera, ± 1 σ")
    above.set_title("from above")
    for values, colour, label in (
        (found.before, GUESSED, "lamps as first guessed"),
        (found.after, FOUND, "lamps as found"),
    ):
        departure = 100.0 * np.expm1(np.abs(values[:, 1]))
        edges = np.quantile(found.range, np.linspace(0.0, 1.0, 13))
        place = np.clip(np.searchsorted(edges, found.range) - 1, 0, 11)
        light.plot(
            0.5 * (edges[1:] + edges[:-1]),
            [np.median(departure[place == k]) if (place == k).any() else np.nan
             for k in range(12)],
            "o-", color=colour, label=label)
    light.set_xlabel("range [m]")
    light.set_ylabel("median deviation [%]")
    light.set_title("light of points, relative to the model")
    light.set_ylim(bottom=0.0)
    light.grid(alpha=0.25)
    light.legend(frameon=False)
    figure.savefig(path, dpi=DPI)
