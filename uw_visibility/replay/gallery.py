# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pictures of replayed frames: raw, enhanced and disparity side by side."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compressed import read_compressed
from uw_visibility.errors import InputError
from uw_visibility.images import write_png
from uw_visibility.messages import read_image
from uw_visibility.replay.decoder import header_stamp
from uw_visibility.replay.options import ReplayOptions
from uw_visibility.replay.reader import BagReader
from uw_visibility.replay.results import NAME
from uw_visibility.replay.table import nanoseconds, read_columns, read_rows
from uw_visibility.replay.topics import Selection

# Disparities are drawn over the range that this share of the matched pixels has.
DRAWN_SHARE = (1.0, 99.0)
LARGEST_VIDEO_WIDTH = 1920
LEFT_TOPIC, DISPARITY_TOPIC = "/left/enhanced/image", "/disparity"


class Picture(NamedTuple):
    """A frame's images, RGB uint8 (H, W, 3) each, and its row of the table.

    Attributes
    ----------
    row : dict of str to str
    raw, enhanced, disparity : (H, W, 3) uint8 ndarray
    drawn : tuple of float or None
        The disparities that the ends of the colours stand for, px.
    """

    row: dict[str, str]
    raw: NDArray[np.uint8]
    enhanced: NDArray[np.uint8]
    disparity: NDArray[np.uint8]
    drawn: tuple[float, float] | None

    def side_by_side(self) -> NDArray[np.uint8]:
        """Return the three in a row."""
        height = self.enhanced.shape[0]
        scale = height / self.raw.shape[0]
        raw = self.raw
        if scale != 1.0:
            raw = _fit(raw, round(raw.shape[1] * scale))
        return np.concatenate((raw, self.enhanced, self.disparity), axis=1)


def pictures(
    folder: Path, reader: BagReader, selection: Selection, frames: Collection[str] | None
) -> Iterator[Picture]:
    """Yield pictures of frames, in order, from the result and the recording.

    Parameters
    ----------
    folder : Path
        Of the result.
    reader : BagReader
        The recording.
    selection : Selection
        Topics used.
    frames : collection of str or None
        Numbers of the frames; None for all. Those without result are left out.
    """
    with BagReader(folder / NAME) as results:
        for row in read_rows(folder / "frames.csv"):
            if row["reason"] or (frames is not None and row["frame"] not in frames):
                continue
            time = nanoseconds(row["time"])
            enhanced = _at(results, LEFT_TOPIC, time, nanoseconds(row["stamp"]))
            disparity = _at(results, DISPARITY_TOPIC, time, nanoseconds(row["stamp"]))
            raw = _at(reader, selection.left, time, nanoseconds(row["stamp"]))
            if enhanced is None or disparity is None or raw is None:
                continue
            yield Picture(
                row, _shown(_pixels(raw)), _shown(_pixels(enhanced)), *_coloured(disparity)
            )


def write_pictures(
    folder: Path, reader: BagReader, selection: Selection, options: ReplayOptions
) -> None:
    """Write ``images/`` and ``video.mp4``, where they are wanted.

    Raises
    ------
    InputError
        If the video cannot be written.
    """
    if options.images:
        chosen = [r["frame"] for r in read_rows(folder / "frames.csv")][:: options.images]
        (folder / "images").mkdir(exist_ok=True)
        for picture in pictures(folder, reader, selection, set(chosen)):
            name = f"frame_{int(picture.row['frame']):06d}.png"
            write_png(folder / "images" / name, picture.side_by_side())
    if options.video:
        _write_video(folder, pictures(folder, reader, selection, None))


def _write_video(folder: Path, shown: Iterator[Picture]) -> None:
    stamps = read_columns(folder / "frames.csv", ["stamp"])["stamp"]
    steps = np.diff(stamps)
    steps = steps[steps > 0.0]
    rate = float(np.clip(1.0 / np.median(steps), 0.5, 60.0)) if steps.size else 5.0
    writer: Any = None
    size = (0, 0)
    for picture in shown:
        image = picture.side_by_side()
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
        seconds, nanosec = header_stamp(message.data, reader.ros1)
        if seconds * 1_000_000_000 + nanosec == stamp:
            return reader.deserialize(message)
    return None


def _pixels(message: Any) -> NDArray[Any]:
    if hasattr(message, "format"):
        return read_compressed(message)[0]
    return read_image(message)


def _shown(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return an image as 8 bit RGB."""
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) if image.ndim == 2 else image


def _coloured(message: Any) -> tuple[NDArray[np.uint8], tuple[float, float] | None]:
    """Return a disparity image in colours, black where nothing matched, and their ends, px."""
    image = message.image
    data = np.frombuffer(image.data, np.float32).reshape(image.height, image.width)
    known = data >= message.min_disparity
    if not known.any():
        return np.zeros((*data.shape, 3), np.uint8), None
    low, high = (float(value) for value in np.percentile(data[known], DRAWN_SHARE))
    scaled = np.clip((data - low) / max(high - low, 1e-6), 0.0, 1.0)
    coloured = cv2.applyColorMap((255.0 * scaled).astype(np.uint8), cv2.COLORMAP_TURBO)
    coloured[~known] = 0
    return np.asarray(cv2.cvtColor(coloured, cv2.COLOR_BGR2RGB), np.uint8), (low, high)


def _fit(image: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    height = round(image.shape[0] * width / image.shape[1])
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))


def preview(image: NDArray[np.uint8], width: int) -> bytes:
    """Return an image as PNG, at most so wide."""
    if image.shape[1] > width:
        image = _fit(image, width)
    _, content = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    return bytes(content.tobytes())


