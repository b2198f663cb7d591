# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Log of the frames of a replay as JSON lines, and resuming of an interrupted replay from it.

Numbers are restored bit by bit: floats are written by ``float.hex``, arrays as bytes. Nothing in
the file is executed, because it may come from elsewhere with its folder.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Collection, Iterator
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.messages.estimates import ImageHeader
from uw_visibility.replay.bags.reader import BagReader, UnreadableError
from uw_visibility.replay.records import FrameEstimate, FrameRecord
from uw_visibility.replay.results.folder import MESSAGES, TABLE
from uw_visibility.replay.table import read_rows
from uw_visibility.replay.work import FrameAnswer
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.blocks import Blocks
from uw_visibility.water.estimate import LampLight, WaterEstimate
from uw_visibility.water.lamps.nodes import Nodes
from uw_visibility.water.lamps.tracks import GroundView
from uw_visibility.water.meaning.assessment import Visibility
from uw_visibility.water.observations import Envelopes

NAME = "frames.jsonl"

# A frame takes about 60 kB.
_LONGEST_LINE = 1 << 22
_DTYPES = ("<f8", "<f4", "<i8")
_CLASSES: dict[str, type[Any]] = {
    kind.__name__: kind for kind in (
        FrameRecord, FrameEstimate, WaterEstimate, LampLight, Nodes, Envelopes, Visibility,
        StereoRig, ImageHeader, Blocks,
    )
}
_SHAPES: dict[type[Any], dict[str, tuple[int, ...]]] = {
    WaterEstimate: {
        "attenuation": (3,), "ambient_light": (3,), "covariance": (6, 6), "light": (3,),
        "light_covariance": (3, 3), "clearest": (3,),
    },
    LampLight: {
        "attenuation": (3,), "power": (3,), "scattering": (3,), "daylight": (3,), "veil": (3,)},
    Blocks: {"clipped": (3,), "black": (3,), "noise": (3,)},
}


def line_of(record: FrameRecord) -> str:
    """Return the line for the record of a frame."""
    return json.dumps(_encoded(record)) + "\n"


def read_records(folder: Path) -> Iterator[FrameRecord]:
    """Yield the records in the folder of a replay, without a truncated last line.

    Raises `InputError` if the file is not a log of frames.
    """
    path = folder / NAME
    if not path.is_file():
        return
    with path.open("rb") as file:
        for number in range(1, 1 << 62):
            line = file.readline(_LONGEST_LINE)
            if not line.endswith(b"\n") and len(line) < _LONGEST_LINE:
                return
            try:
                record = _decoded(json.loads(line))
                if not isinstance(record, FrameRecord):
                    raise TypeError(type(record))
            except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
                raise InputError(
                    f"{path}, line {number}, is not a frame of a replay: --force starts over"
                ) from error
            yield record


def _encoded(value: Any) -> Any:
    """Return a record or a part of it as JSON values."""
    if value is None or isinstance(value, Status):
        return value
    if isinstance(value, GroundView):
        # Left out, since ten times as large as the rest. A resumed survey starts new tracks.
        return None
    if isinstance(value, np.ndarray):
        kind = value.dtype.newbyteorder("<").str
        data = np.ascontiguousarray(value, kind).tobytes()
        return {kind: base64.b64encode(data).decode(), "shape": list(value.shape)}
    if type(value) in _CLASSES.values():
        names = type(value).__annotations__
        return {type(value).__name__: {name: _encoded(getattr(value, name)) for name in names}}
    if isinstance(value, dict):
        return {"dict": {name: _encoded(item) for name, item in value.items()}}
    if isinstance(value, tuple):
        return [_encoded(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return {"float": float(value).hex()}
    return value if isinstance(value, (str, bool)) else int(value)


def _decoded(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_decoded(item) for item in value)
    if not isinstance(value, dict):
        return value
    (kind, content), *shape = value.items()
    if kind == "float":
        return float.fromhex(content)
    if kind in _DTYPES:
        array = np.frombuffer(base64.b64decode(content, validate=True), kind)
        return array.astype(array.dtype.newbyteorder("=")).reshape(shape[0][1])
    if kind == "dict":
        return {name: _decoded(item) for name, item in content.items()}
    found = {name: _decoded(item) for name, item in content.items()}
    return _made(_CLASSES[kind], found)


def _made(kind: type[Any], found: dict[str, Any]) -> Any:
    """Make a record from its fields, after a check of types and shapes."""
    shapes = _SHAPES.get(kind, {})
    for name, hint in get_type_hints(kind).items():
        if hint is Status:
            found[name] = Status(found[name])
        elif name in found and not _is_a(found[name], hint):
            raise TypeError(name)
        elif name in shapes and found[name] is not None and found[name].shape != shapes[name]:
            raise ValueError(name)
    if kind is Blocks and (
        found["range"].ndim != 2 or found["light"].shape != (*found["range"].shape, 3)
    ):
        raise ValueError("light")
    if kind is WaterEstimate:
        found["channel_status"] = tuple(Status(status) for status in found["channel_status"])
    return kind(**found)


def _is_a(value: Any, hint: Any) -> bool:
    """Return whether a value has a type or one of a union; generic types by their origin only."""
    options = get_args(hint) if isinstance(hint, UnionType) else (hint,)
    return any(type(value) is (get_origin(option) or option) for option in options)


class EarlierPart:
    """Frames of an interrupted replay, to be reused.

    Only messages of topics that depend on a single frame are reused.
    """

    def __init__(self, folder: Path, topics: Collection[str]) -> None:
        self._folder = folder
        self._topics = {f"/{topic}" for topic in topics}
        self._table = folder / TABLE

    def frames(self) -> int:
        """Return how many rows its table has."""
        return sum(1 for _ in read_rows(self._table)) if self._table.is_file() else 0

    def answers(self) -> Iterator[FrameAnswer]:
        """Yield the frames whose row and messages are all there, in order."""
        if not self._table.is_file():
            return
        groups, records = self._groups(), read_records(self._folder)
        for row, record in zip(read_rows(self._table), records, strict=False):
            if row.get("frame") != str(record.frame):
                return
            if record.estimate is None:
                yield FrameAnswer(record)
                continue
            group = next(groups, None)
            if group is None or group[0] != record.time:
                return
            yield FrameAnswer(record, group[1], resumed=True)

    def _groups(self) -> Iterator[tuple[int, list[tuple[str, bytes]]]]:
        """Yield time and messages of the frames with messages."""
        path = self._folder / MESSAGES
        whole = path.is_file()
        if not whole:
            # After a crash the file is still in its first folder, without an end.
            path = self._folder / "results" / MESSAGES
        try:
            reader = BagReader(path)
        except (UnreadableError, OSError):
            return
        with reader:
            time, group = 0, dict[str, bytes]()
            for message in reader.messages():
                if message.topic not in self._topics:
                    continue
                topic = message.topic.removeprefix("/")
                # A frame has at most one message per topic, at the time of the frame.
                if group and (message.time != time or topic in group):
                    yield time, list(group.items())
                    group = {}
                time = message.time
                group[topic] = message.data
            if group and whole:
                yield time, list(group.items())
