# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Kinds of messages that no camera should send, each with what the node has to say of it.

Encodings times what can be wrong with an image; pairs, CameraInfo, stamps and frames; values
of a depth sensor. Those of compressed images are in `compressed_kinds`.
"""

from __future__ import annotations

import array
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

ANSWERED = ""
FUTURE = 2**31 - 1
ESCAPES = "\x1b[2J\n[INFO] forged\u202e"


class MessageKind(NamedTuple):
    """A kind of faulty frame.

    Attributes
    ----------
    name : str
    change : callable
        Changes the messages of a good frame, by the names of `input_topics`; a topic that
        is taken out is not sent.
    says : str
        What the reason for the loss has in it; `ANSWERED` where the frame has an answer.
    """

    name: str
    change: Callable[[dict[str, Any]], None]
    says: str


def set_fields(topic: str, **values: Any) -> Callable[[dict[str, Any]], None]:
    """Set fields of a message, at any depth: ``a__b`` stands for a.b."""
    def change(frame: dict[str, Any]) -> None:
        for path, value in values.items():
            message = frame[topic]
            *parents, name = path.split("__")
            for parent in parents:
                message = getattr(message, parent)
            setattr(message, name, value)
    return change


def _put(frame: dict[str, Any], topic: str, message: Any) -> None:
    """Replace a message by one with the same header."""
    message.header = frame[topic].header
    frame[topic] = message


def as_data(content: bytes) -> array.array[int]:
    return array.array("B", content)


def encode(pixels: np.ndarray, encoding: str) -> np.ndarray:
    """Return an RGB image in the layout of an encoding, roughly."""
    deep = encoding.endswith("16")
    grey = pixels[..., 1]
    if encoding.startswith(("mono", "bayer", "8UC1")):
        found = grey
    elif encoding.startswith(("uyvy", "yuv", "yuyv")):
        neutral = np.full_like(grey, 128)
        luma_first = encoding in ("yuyv", "yuv422_yuy2")
        found = np.dstack([grey, neutral] if luma_first else [neutral, grey])
    elif "a" in encoding:
        found = np.dstack([pixels, np.full_like(grey, 255)])
    else:
        found = pixels
    return found.astype(np.uint16) * 257 if deep else found


def image_kinds(
    encodings: list[str], image: Callable[..., Any], views: tuple[np.ndarray, np.ndarray]
) -> Iterator[MessageKind]:
    """Yield what can be wrong with images of each encoding.

    Parameters
    ----------
    encodings : list of str
    image : callable
        Makes an Image message of pixels in their own layout and an encoding.
    views : tuple of ndarray
        The left and the right image, RGB.
    """
    def both(encoding: str, **changes: Any) -> Callable[[dict[str, Any]], None]:
        def change(frame: dict[str, Any]) -> None:
            for side, pixels in zip(("left", "right"), views, strict=True):
                _put(frame, f"{side}/image", image(encode(pixels, encoding), encoding))
            set_fields("right/image", **changes)(frame)
        return change

    height = len(views[0])
    for encoding in encodings:
        whole = encode(views[1], encoding).tobytes()
        step = len(whole) // height
        for name, changes, says in (
            ("as it should be", {}, ANSWERED),
            ("a step below a row", {"step": step - 1}, "step"),
            ("no step", {"step": 0}, "step"),
            ("a step beyond the data", {"step": 2**32 - 1}, "truncated"),
            ("half of the data", {"data": as_data(whole[: len(whole) // 2])}, "truncated"),
            ("all but a byte", {"data": as_data(whole[:-1])}, "truncated"),
            ("no data", {"data": as_data(b"")}, "truncated"),
            ("no rows", {"height": 0}, "not empty"),
            ("no columns", {"width": 0}, "not empty"),
            ("a row less", {"height": height - 1}, "camera_info"),
            ("four billion rows", {"height": 2**32 - 1}, "truncated"),
            ("four billion columns", {"width": 2**32 - 1, "step": 2**32 - 1}, "step|truncated"),
            ("rows that are longer", {
                "step": step + 32, "data": as_data(b"".join(
                    whole[row * step : (row + 1) * step] + bytes(32) for row in range(height))),
            }, ANSWERED),
        ):
            yield MessageKind(f"{encoding}: {name}", both(encoding, **changes), says)
    for text in (
        "", " ", "RGB8", "rgb8 ", "32FC1", "64FC3", "16UC1", "8SC1", "bayer_rggb12", "yuv420",
        "nv21", "jpeg", "rgb8; jpeg compressed bgr8", ESCAPES, "x" * 100_000, "\xff\u0300",
    ):
        yield MessageKind(
            f"encoding {text[:20]!r}", set_fields("left/image", encoding=text), "encoding"
        )
    for left, right in (("rgb8", "mono8"), ("rgb8", "rgb16"), ("mono16", "rgb16")):
        def differ(frame: dict[str, Any], pair: tuple[str, str] = (left, right)) -> None:
            for side, pixels, name in zip(("left", "right"), views, pair, strict=True):
                _put(frame, f"{side}/image", image(encode(pixels, name), name))
        yield MessageKind(f"{left} and {right}", differ, "one size and type")


def pair_kinds(
    image: Callable[..., Any], views: tuple[np.ndarray, np.ndarray]
) -> Iterator[MessageKind]:
    """Yield pairs that show nothing, or not what a pair shows."""
    left, right = views
    noise = np.random.default_rng(0).integers(0, 256, (2, *left.shape), np.uint8)
    for name, pair, says in (
        ("left and right exchanged", (right, left), "exchange left and right"),
        ("black", (np.zeros_like(left),) * 2, "dark"),
        ("white", (np.full_like(left, 255),) * 2, "saturated"),
        ("grey", (np.full_like(left, 100),) * 2, "texture"),
        ("twice the left image", (left, left), ".*"),
        ("upside down", (left[::-1].copy(), right[::-1].copy()), ".*"),
        ("right alone upside down", (left, right[::-1].copy()), ".*"),
        ("mirrored", (left[:, ::-1].copy(), right[:, ::-1].copy()), ".*"),
        ("noise", (noise[0], noise[1]), ".*"),
        ("very dark", (left // 64, right // 64), ".*"),
        ("right much brighter", (left // 4, right), ".*"),
        ("negative", (255 - left, 255 - right), ".*"),
        ("one black", (left, np.zeros_like(right)), ".*"),
    ):
        def change(frame: dict[str, Any], pair: tuple[Any, Any] = pair) -> None:
            for side, pixels in zip(("left", "right"), pair, strict=True):
                _put(frame, f"{side}/image", image(pixels, "rgb8"))
        yield MessageKind(name, change, says)
    for rows, columns in ((1, 1), (2, 160), (120, 1), (63, 160), (120, 95)):
        def small(frame: dict[str, Any], size: tuple[int, int] = (rows, columns)) -> None:
            for side, pixels in zip(("left", "right"), views, strict=True):
                part = np.ascontiguousarray(pixels[: size[0], : size[1]])
                _put(frame, f"{side}/image", image(part, "rgb8"))
                set_fields(f"{side}/camera_info", height=size[0], width=size[1])(frame)
        yield MessageKind(f"{columns}x{rows} pixels", small, "give at least")

    def of_two_sizes(frame: dict[str, Any]) -> None:
        _put(frame, "right/image", image(np.ascontiguousarray(right[:100]), "rgb8"))
        frame["right/camera_info"].height = 100

    yield MessageKind("two sizes", of_two_sizes, "one size")


def info_kinds() -> Iterator[MessageKind]:
    """Yield CameraInfo that cannot be, or that does not belong to the image."""
    for side in ("left", "right"):
        topic = f"{side}/camera_info"
        for matrix, size in (("k", 9), ("p", 12)):
            for value in (0.0, math.nan, math.inf, -math.inf):
                yield MessageKind(
                    f"{side} {matrix} of {value}", set_fields(topic, **{matrix: [value] * size}),
                    "camera_info|calibrat|finite",
                )
            for place in (0, 4 if matrix == "k" else 5):
                for value in (math.nan, -200.0, 1e300, 1e-300):
                    name = f"{side} {matrix}[{place}] = {value}"
                    yield MessageKind(name, _element(topic, matrix, place, value), ".*")
        for name, values, says in (
            ("no size", {"width": 0, "height": 0}, "publish the size"),
            ("another size", {"width": 320, "height": 240}, "camera_info"),
            ("an absurd size", {"width": 2**32 - 1, "height": 2**32 - 1},
             "max_megapixels|camera_info"),
            ("binning of all", {"binning_x": 2**32 - 1}, "publish the size|camera_info"),
            ("binning", {"binning_x": 2, "binning_y": 2}, "camera_info"),
            ("a region beyond", {"roi__width": 2**32 - 1, "roi__height": 2**32 - 1},
             "max_megapixels|camera_info"),
            ("another region", {"roi__width": 80, "roi__height": 60}, "camera_info"),
            ("a region far off", {"roi__x_offset": 2**32 - 1}, ".*"),
            ("an unknown distortion", {"distortion_model": ESCAPES}, ".*"),
            ("a distortion without end", {"d": [1e300] * 10_000}, ".*"),
            ("a rotation of nothing", {"r": [math.nan] * 9}, ".*"),
        ):
            yield MessageKind(f"{side} camera_info: {name}", set_fields(topic, **values), says)
    for name, place, value, says in (
        ("without a baseline", 3, 0.0, "baseline|P"),
        ("with a baseline to the left", 3, 20.0, "baseline|P|exchange"),
        ("with a baseline without end", 3, -1e300, ".*"),
        ("of another focal length", 0, 300.0, "focal|P"),
        ("of another height", 6, 90.0, ".*"),
        ("of another form", 8, 1.0, ".*"),
    ):
        yield MessageKind(
            f"right camera {name}", _element("right/camera_info", "p", place, value), says
        )


def _element(topic: str, matrix: str, place: int, value: float) -> Callable[[dict[str, Any]], None]:
    def change(frame: dict[str, Any]) -> None:
        values = np.array(getattr(frame[topic], matrix), np.float64)
        values[place] = value
        setattr(frame[topic], matrix, values)
    return change


def header_kinds() -> Iterator[MessageKind]:
    """Yield stamps and frames that cannot be, and images without partner."""
    everything = ("left/image", "right/image", "left/camera_info", "right/camera_info")

    def stamped(sec: int | None, nanosec: int | None, topics: tuple[str, ...] = everything) -> Any:
        def change(frame: dict[str, Any]) -> None:
            for topic in topics:
                stamp = frame[topic].header.stamp
                stamp.sec = stamp.sec if sec is None else sec
                stamp.nanosec = stamp.nanosec if nanosec is None else nanosec
        return change

    yield MessageKind("stamps of zero", stamped(0, 0), "without a stamp")
    yield MessageKind("negative stamps", stamped(-1, 0), ".*")
    yield MessageKind("the earliest stamps", stamped(-(2**31), 0), ".*")
    yield MessageKind("the latest stamps", stamped(FUTURE, 999_999_999), ANSWERED)
    yield MessageKind("a second too many of nanoseconds", stamped(None, 2**32 - 1), ANSWERED)
    yield MessageKind("stamps of long ago", stamped(1, 1), ".*")
    for name, sec, nanosec in (("zero", 0, 0), ("a nanosecond later", None, 6),
                               ("of long ago", 1, 1), ("of the future", FUTURE, 0)):
        yield MessageKind(
            f"right stamp {name}", stamped(sec, nanosec, ("right/image",)),
            "unmatched|without a stamp|out of order",
        )
    yield MessageKind(
        "camera_info of another time", stamped(7, 7, ("left/camera_info", "right/camera_info")),
        ANSWERED,
    )
    for side in ("left", "right"):
        def alone(frame: dict[str, Any], side: str = side) -> None:
            del frame[f"{side}/image"]
        yield MessageKind(f"no {side} image", alone, "unmatched")
        for text in ("", "/", ESCAPES, "x" * 100_000, "map", "\u0000".replace("\0", " ")):
            yield MessageKind(
                f"{side} frame {text[:20]!r}", set_fields(f"{side}/image", header__frame_id=text),
                ANSWERED,
            )

    def exchanged(frame: dict[str, Any]) -> None:
        for name in ("image", "camera_info"):
            pair = frame[f"left/{name}"], frame[f"right/{name}"]
            frame[f"right/{name}"], frame[f"left/{name}"] = pair

    yield MessageKind("cables exchanged", exchanged, "exchange|baseline|P")


class SensorKind(NamedTuple):
    """A kind of message of a depth sensor: z, its variance, seconds of its stamp."""

    name: str
    z: float
    variance: float
    stamped: bool
    says: str


def sensor_kinds() -> Iterator[SensorKind]:
    """Yield depths that no sensor measures."""
    for z in (math.nan, math.inf, -math.inf):
        yield SensorKind(f"z = {z}", z, 0.01, True, "finite")
    for z in (12_001.0, -12_001.0, 1e200, -1e200, 1e308):
        yield SensorKind(f"z = {z}", z, 0.01, True, "no ocean")
    for variance in (math.nan, math.inf, -0.5, -1e300):
        yield SensorKind(f"variance {variance}", -4.0, variance, True, "variance")
    yield SensorKind("a depth without a stamp", -4.0, 0.01, False, "stamp")
