# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Gallery of replayed frames: raw, enhanced and disparity, in one scale of colours."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Image8
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
from uw_visibility.messages.stamps import header_stamp, nanoseconds
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.columns import COLUMNS
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.inputs.topics import Selection
from uw_visibility.replay.report.sentences import clock, headline
from uw_visibility.replay.results.mcap import NAME
from uw_visibility.replay.table import read_rows, read_table
from uw_visibility.stereo.rig import DISPARITY_STDDEV

# Frames from which the colour scale is chosen.
SCALE_FRAMES = 16
# Rows and columns per sampled pixel.
STEP = 4
LARGEST_VIDEO_WIDTH = 1920
LEFT_TOPIC, DISPARITY_TOPIC = "/left/enhanced/image", "/disparity"


class ColourScale(NamedTuple):
    """Colour scale: the disparities, px, that the ends of the colours stand for.

    `focal_baseline` is focal length times baseline, px m: range times disparity.
    """

    low: float
    high: float
    focal_baseline: float

    @classmethod
    def of(cls, messages: Iterable[Any]) -> ColourScale | None:
        """Return the scale that suits some DisparityImages; None where nothing matched."""
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

    def draw(self, message: Any) -> NDArray[np.uint8]:
        """Return a DisparityImage in colours, (H, W, 3) RGB, black where nothing matched."""
        return draw_disparity(read_disparity(message), self.low, self.high)

    def describe(self, disparity: float) -> str:
        """Return a disparity, and the range that it is, in words."""
        if disparity <= 0.0:
            return f"{disparity:.1f} px"
        return f"{disparity:.1f} px ({self.focal_baseline / disparity:.3g} m)"


def gradient() -> str:
    """Return the colours from the lowest disparity to the highest, as CSS has it."""
    stops = viridis(np.linspace(0.0, 1.0, 17)[None])[0]
    return ", ".join(f"rgb({r}, {g}, {b})" for r, g, b in stops)


class Picture(NamedTuple):
    """A frame's images, RGB uint8 (H, W, 3) each, and its row of the table."""

    row: dict[str, str]
    raw: Image8
    enhanced: Image8
    disparity: NDArray[np.uint8]

    def parts(self) -> dict[str, NDArray[np.uint8]]:
        """Return the three by what they show."""
        return {
            "left image as recorded": self.raw, "left image without the water": self.enhanced,
            "disparity": self.disparity,
        }

    def side_by_side(self, scale: ColourScale | None, assumed: str) -> Image8:
        """Return the three in a row, with titles, visibility, what was assumed, and a scale."""
        height = self.enhanced.shape[0]
        factor = height / self.raw.shape[0]
        raw = self.raw if factor == 1.0 else _fit(self.raw, round(self.raw.shape[1] * factor))
        ends = scale and tuple(d / scale.focal_baseline for d in scale[:2])
        return side_by_side(raw, self.enhanced, self.disparity, ends, [self.words(), assumed])

    def words(self) -> str:
        """Say which frame it is, and how far one sees or why that is not known, in one line."""
        row, name = self.row, "visibility_distance"
        low, middle, high = (row[f"{name}_low"], row[name], row[f"{name}_high"])
        if low and middle and high:
            told = headline({name: [float(v) for v in (low, middle, high)]}, "")[0]
            text = f"{told.title} {told.value}"
        else:
            why = COLUMNS["visibility_status"].meaning(row["visibility_status"])
            text = f"visibility distance: {why}"
        return f"frame {row['frame']}, {clock(nanoseconds(row['stamp']))}: {text}"


class Gallery:
    """Pictures of a result's frames, from its folder and, raw ones, from the recording.

    scale: of the disparities of all pictures; None where nothing matched, and all are black. It is
        chosen from evenly spaced frames, and does not depend on which pictures are wanted.
    """

    def __init__(self, folder: Path, reader: BagReader, selection: Selection) -> None:
        self._folder, self._reader, self._raw_topic = folder, reader, selection.left
        rows = [
            (nanoseconds(row["time"]), nanoseconds(row["stamp"]))
            for row in read_rows(folder / "frames.csv") if not row["reason"]
        ]
        chosen = {
            round(index) for index in np.linspace(0, len(rows) - 1, min(SCALE_FRAMES, len(rows)))
        }
        with BagReader(folder / NAME) as results:
            found = (_at(results, DISPARITY_TOPIC, *rows[index]) for index in sorted(chosen))
            self.scale = ColourScale.of(message for message in found if message is not None)

    def pictures(self, frames: Collection[str] | None = None) -> Iterator[Picture]:
        """Yield pictures of the frames of these numbers, or of all, in order; only of results."""
        with BagReader(self._folder / NAME) as results:
            for row in read_rows(self._folder / "frames.csv"):
                if row["reason"] or (frames is not None and row["frame"] not in frames):
                    continue
                time, stamp = nanoseconds(row["time"]), nanoseconds(row["stamp"])
                enhanced = _at(results, LEFT_TOPIC, time, stamp)
                disparity = _at(results, DISPARITY_TOPIC, time, stamp)
                raw = _at(self._reader, self._raw_topic, time, stamp)
                if enhanced is None or disparity is None or raw is None:
                    continue
                after = shown(read_pixels(enhanced, "image")[0])
                drawn = np.zeros_like(after) if self.scale is None else self.scale.draw(disparity)
                yield Picture(row, shown(read_pixels(raw, "image")[0]), after, drawn)

    def write(self, options: ReplayOptions, assumed: str) -> None:
        """Write ``images/`` and ``video.mp4``, where they are wanted; `assumed` stands in them.

        Raises `InputError` if the video cannot be written.
        """
        folder = self._folder
        if options.images:
            chosen = [r["frame"] for r in read_rows(folder / "frames.csv")][:: options.images]
            (folder / "images").mkdir(exist_ok=True)
            for picture in self.pictures(set(chosen)):
                name = f"frame_{int(picture.row['frame']):06d}.png"
                write_png(folder / "images" / name, picture.side_by_side(self.scale, assumed))
        if options.video:
            _write_video(folder, (p.side_by_side(self.scale, assumed) for p in self.pictures()))


def _write_video(folder: Path, frames: Iterator[Image8]) -> None:
    steps = np.diff(read_table(folder / "frames.csv", {"stamp": COLUMNS["stamp"]})["stamp"])
    steps = steps[steps > 0.0]
    rate = float(np.clip(1.0 / np.median(steps), 0.5, 60.0)) if steps.size else 5.0
    writer: Any = None
    size = (0, 0)
    for image in frames:
        if writer is None:
            width = min(image.shape[1], LARGEST_VIDEO_WIDTH) // 2 * 2
            size = (width, round(image.shape[0] * width / image.shape[1]) // 2 * 2)
            code = cv2.VideoWriter.fourcc(*"mp4v")
            writer = cv2.VideoWriter(str(folder / "video.mp4"), code, rate, size)
            if not writer.isOpened():
                raise InputError("this OpenCV cannot write mp4: leave out --video")
        writer.write(cv2.cvtColor(cv2.resize(image, size), cv2.COLOR_RGB2BGR))
    if writer is not None:
        writer.release()


def _at(reader: BagReader, topic: str, time: int, stamp: int) -> Any:
    """Return the message of a topic that was received at a time and has a stamp."""
    for message in reader.messages([topic], time, time + 1):
        if header_stamp(message.data, ros1=reader.ros1) == stamp:
            return reader.deserialize(message)
    return None


def _fit(image: Image8, width: int) -> NDArray[np.uint8]:
    height = round(image.shape[0] * width / image.shape[1])
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))


def preview(image: Image8, width: int) -> tuple[bytes, tuple[int, int]]:
    """Return an image as PNG, at most so wide, with its height and width."""
    if image.shape[1] > width:
        image = _fit(image, width)
    _, content = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    return bytes(content.tobytes()), (image.shape[0], image.shape[1])
