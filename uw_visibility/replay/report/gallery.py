# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Gallery of replayed frames: raw, enhanced and disparity, with one colour scale."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Image8
from uw_visibility.images.files import write_png
from uw_visibility.images.overview import (
    colour_ends,
    draw_disparity,
    shown,
    side_by_side,
    viridis,
)
from uw_visibility.messages.frames import read_pixels
from uw_visibility.messages.images import read_disparity
from uw_visibility.messages.stamps import header_stamp
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.columns import COLUMNS
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.inputs.topics import Selection
from uw_visibility.replay.report.sentences import clock, headline, number
from uw_visibility.replay.results.folder import MESSAGES
from uw_visibility.replay.table import Columns
from uw_visibility.stereo.rectification import rectify_one
from uw_visibility.stereo.rig import DISPARITY_STDDEV

# Most frames for the choice of the colour scale.
SCALE_FRAMES = 16
# Step of sampled rows and columns, px.
STEP = 4
LARGEST_VIDEO_WIDTH = 1920
LEFT_TOPIC, DISPARITY_TOPIC = "/left/enhanced/image", "/disparity"
INFO_TOPIC = "/left/enhanced/camera_info"


class ColourScale(NamedTuple):
    """Colour scale: disparities of its ends, px.

    `focal_baseline` is focal length times baseline, px m: range times disparity.
    """

    low: float
    high: float
    focal_baseline: float

    @classmethod
    def of(cls, messages: Iterable[Any]) -> ColourScale | None:
        """Return the scale for some DisparityImages; None if nothing matched."""
        known: list[NDArray[np.float32]] = []
        focal_baseline = math.nan
        for message in messages:
            data = read_disparity(message)[::STEP, ::STEP]
            known.append(data[np.isfinite(data)])
            focal_baseline = float(message.f) * float(message.t)
        values = np.concatenate(known) if known else np.empty(0, np.float32)
        if not values.size:
            return None
        return cls(*colour_ends(values, DISPARITY_STDDEV), focal_baseline)

    def describe(self, disparity: float) -> str:
        """Return a disparity with its range as text."""
        if disparity <= 0.0:
            return f"{disparity:.1f} px"
        return f"{disparity:.1f} px ({number(self.focal_baseline / disparity)} m)"


def gradient() -> str:
    """Return the colours from the lowest to the highest disparity as CSS."""
    stops = viridis(np.linspace(0.0, 1.0, 17)[None])[0]
    return ", ".join(f"rgb({r}, {g}, {b})" for r, g, b in stops)


class Picture(NamedTuple):
    """Number, caption and images of a frame; images are RGB uint8 (H, W, 3)."""

    frame: int
    caption: str
    raw: Image8
    enhanced: Image8
    disparity: NDArray[np.uint8]

    def parts(self) -> dict[str, NDArray[np.uint8]]:
        """Return the three images by their titles."""
        return {
            "left image as recorded": self.raw, "left image without the water": self.enhanced,
            "disparity": self.disparity,
        }

    def side_by_side(self, scale: ColourScale | None, assumed: str) -> Image8:
        """Return the three images in a row, with titles, visibility, assumptions and a scale."""
        ends = scale and tuple(d / scale.focal_baseline for d in scale[:2])
        return side_by_side(self.raw, self.enhanced, self.disparity, ends, [self.caption, assumed])


class Gallery:
    """Pictures of the frames of a result, from its folder; raw images from the recording.

    table: table of the result, as `read_table` returns it.
    scale: disparity scale of all pictures; None if nothing matched, and all are black. It is
        chosen from evenly spaced frames, independent of the requested pictures.
    rectify: the images of the recording are to be rectified, as those of the result are.
    """

    def __init__(
        self, folder: Path, table: Columns, reader: BagReader, selection: Selection, *,
        rectify: bool,
    ) -> None:
        self._folder, self._table = folder, table
        self._reader, self._raw_topic = reader, selection.left
        self._rectify = rectify
        self._rows = np.flatnonzero(table["reason"] == "").tolist()
        count = len(self._rows)
        chosen = {round(index) for index in np.linspace(0, count - 1, min(SCALE_FRAMES, count))}
        with BagReader(folder / MESSAGES) as results:
            found = (
                self._at(results, DISPARITY_TOPIC, self._rows[index]) for index in sorted(chosen))
            self.scale = ColourScale.of(message for message in found if message is not None)

    def pictures(self, frames: Collection[int] | None = None) -> Iterator[Picture]:
        """Yield pictures of the frames of these numbers, or of all; only those with a result."""
        with BagReader(self._folder / MESSAGES) as results:
            for row in self._rows:
                frame = int(self._table["frame"][row])
                if frames is not None and frame not in frames:
                    continue
                enhanced = self._at(results, LEFT_TOPIC, row)
                disparity = self._at(results, DISPARITY_TOPIC, row)
                raw = self._at(self._reader, self._raw_topic, row)
                if enhanced is None or disparity is None or raw is None:
                    continue
                after = shown(read_pixels(enhanced, "image")[0])
                # Unmatched pixels are black.
                drawn = np.zeros_like(after) if self.scale is None else draw_disparity(
                    read_disparity(disparity), *self.scale[:2])
                pixels = read_pixels(raw, "image")[0]
                if self._rectify:
                    pixels = rectify_one(pixels, self._at(results, INFO_TOPIC, row), "left")
                before = shown(pixels)
                yield Picture(frame, self._caption(row), before, after, drawn)

    def write(self, options: ReplayOptions, assumed: str) -> None:
        """Write ``images/`` and ``video.mp4`` if requested, with the assumptions `assumed`.

        Raises `InputError` if the video cannot be written.
        """
        folder = self._folder
        if options.images:
            (folder / "images").mkdir(exist_ok=True)
            for picture in self.pictures(set(self._table["frame"][:: options.images])):
                name = f"frame_{picture.frame:06d}.png"
                write_png(folder / "images" / name, picture.side_by_side(self.scale, assumed))
        if options.video:
            frames = (picture.side_by_side(self.scale, assumed) for picture in self.pictures())
            _write_video(folder / "video.mp4", frames, np.diff(self._table["stamp"]))

    def _at(self, reader: BagReader, topic: str, row: int) -> Any:
        """Return the message of a topic for the frame of a row."""
        # A float64 time in s has a resolution of a quarter of a microsecond.
        time = round(1e9 * self._table["time"][row])
        for message in reader.messages([topic], time - 1000, time + 1000):
            stamp = header_stamp(message.data, ros1=reader.ros1)
            if stamp == self._table["datetime"][row]:
                return reader.deserialize(message)
        return None

    def _caption(self, row: int) -> str:
        """Return a caption in one line: frame, and visibility distance or the reason for none."""
        name = "visibility_distance"
        typical = [float(self._table[f"{name}{end}"][row]) for end in ("_low", "", "_high")]
        if np.isfinite(typical).all():
            told = headline({name: typical}, "")[0]
            text = f"{told.title} {told.value}"
        else:
            why = COLUMNS["visibility_status"].meaning(self._table["visibility_status"][row])
            text = f"visibility distance: {why}"
        moment = clock(int(self._table["datetime"][row]))
        return f"frame {self._table['frame'][row]:.0f}, {moment}: {text}"


def _write_video(path: Path, frames: Iterator[Image8], steps: Array) -> None:
    """Write pictures as a video at the median rate of the frames; `steps` between them in s."""
    steps = steps[steps > 0.0]
    rate = float(np.clip(1.0 / np.median(steps), 0.5, 60.0)) if steps.size else 5.0
    writer: Any = None
    size = (0, 0)
    for image in frames:
        if writer is None:
            width = min(image.shape[1], LARGEST_VIDEO_WIDTH) // 2 * 2
            size = (width, round(image.shape[0] * width / image.shape[1]) // 2 * 2)
            code = cv2.VideoWriter.fourcc(*"mp4v")
            writer = cv2.VideoWriter(str(path), code, rate, size)
            if not writer.isOpened():
                raise InputError("this OpenCV cannot write mp4: leave out --video")
        writer.write(cv2.cvtColor(cv2.resize(image, size), cv2.COLOR_RGB2BGR))
    if writer is not None:
        writer.release()
