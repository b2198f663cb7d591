# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Bag reader: ROS 2 (mcap, sqlite3) and ROS 1, in folders or files, split, compressed."""

from __future__ import annotations

import heapq
import re
import stat
import tempfile
from collections import Counter, deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from uw_visibility.config.documents import read_document
from uw_visibility.config.files import check_regular
from uw_visibility.errors import InputError, printable, refusing
from uw_visibility.replay.bags.decoder import Decoder
from uw_visibility.replay.bags.indexed import SUFFIXES, open_file
from uw_visibility.replay.bags.packing import ZSTD, PackingError, unpack, unpack_file
from uw_visibility.replay.bags.storage import LATEST, Channel, Part, Recorded, Storage

PACKED = ".zstd"


class UnreadableError(InputError):
    """The recording exists, but nothing in it can be read."""


@dataclass(frozen=True)
class Layout:
    """Files of a recording."""

    files: list[Path]  # existing files, in the order of metadata.yaml, or of their names
    packed_messages: bool = False  # whether each message is compressed separately
    # numbers of messages by topic, from the metadata
    expected: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # missing parts


class BagReader:
    """Bag reader; use it in a ``with`` statement.

    A damaged recording is read as far as possible; `damage` lists what is missing.

    Parameters
    ----------
    path : str or Path
        Folder of a ROS 2 bag, one of its files, or file of a ROS 1 bag.

    Attributes
    ----------
    path : Path
        As given.
    files : list of Path
        Files of the recording.
    ros1 : bool
        Whether it is a ROS 1 bag.
    channels : dict of str to Channel
        Topics by name, with the numbers of messages from the indexes of all files.

    Raises
    ------
    InputError
        If it is not a bag; `UnreadableError` if nothing in a bag can be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._storages: list[Storage] = []
        self._unusable: Counter[str] = Counter()
        try:
            layout = find_files(self.path)
            self.files, self._notes = layout.files, list(layout.notes)
            self._packed_messages, self._expected = layout.packed_messages, layout.expected
            self._open_files()
        except BaseException:
            self.close()
            raise
        self.ros1 = self.files[0].suffix == ".bag"
        self.channels = {
            topic: replace(channel, count=self._expected.get(topic, channel.count))
            for topic, channel in self._merge_channels().items()
        }
        # Topics with damaged names must not vanish silently.
        self._notes += [
            f"{count} messages on {printable(topic)} are missing: no file names that topic"
            for topic, count in self._expected.items() if count and topic not in self.channels
        ]
        self.decoder = Decoder({c.type: c for c in self.channels.values()}, self.ros1)

    @property
    def topics(self) -> dict[str, str]:
        """Type of message by topic."""
        return {topic: channel.type for topic, channel in self.channels.items()}

    @property
    def span(self) -> tuple[int, int] | None:
        """Times of the first and the last message, ns; None if unknown."""
        spans = [s.span for s in self._storages if s.span is not None]
        # Files without a span are damaged, unless they are empty.
        damaged = any(
            channel.count != 0 for s in self._storages if s.span is None for channel in s.channels)
        if damaged or not spans:
            return None
        return min(begin for begin, _ in spans), max(end for _, end in spans)

    @property
    def damage(self) -> list[str]:
        """Damage found so far, in sentences."""
        notes = [
            *self._notes, *(note for s in self._storages for note in s.damage),
            *(f"{reason} ({count})" for reason, count in self._unusable.items()),
        ]
        # Repeated reading finds the same damage.
        return list(dict.fromkeys(notes))

    def messages(
        self,
        topics: Collection[str] | None = None,
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[Recorded]:
        """Yield the messages of some or all topics in the order of time.

        start, stop: interval of the time of reception, ns, without stop.
        """
        self._unusable.clear()
        for message in self._merged(Part(topics, start, stop)):
            topic = printable(message.topic)
            if not 0 <= message.time < LATEST:
                self._unusable[f"messages on {topic} have no time"] += 1
                continue
            # Without metadata, only the data show that a message is compressed.
            if self._packed_messages or (not self.ros1 and message.data.startswith(ZSTD)):
                try:
                    message = message._replace(data=unpack(message.data, "zstd"))
                except PackingError:
                    self._unusable[f"messages on {topic} cannot be unpacked"] += 1
                    continue
            yield message

    def deserialize(self, message: Recorded) -> Any:
        """Return a recorded message as an object, by the types of the bag."""
        return self.decoder.decode(message)

    def close(self) -> None:
        for storage in self._storages:
            storage.close()
        if self._folder is not None:
            self._folder.cleanup()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *details: object) -> None:
        self.close()

    def _open_files(self) -> None:
        errors = []
        for file in self.files:
            try:
                self._storages.append(open_file(self._unpack(file)))
            except InputError as error:
                errors.append(error)
        if not self._storages:
            kind = UnreadableError if suffix(self.files[0]) in SUFFIXES else InputError
            raise kind(*errors[0].args) from errors[0]
        self._notes += [str(error) for error in errors]

    def _merged(self, part: Part) -> Iterator[Recorded]:
        """Yield the messages of all files, each read from the time on at which it begins.

        Files may overlap: those of several recorders, or by what waits while a recording is split.
        """
        begin, begins = 0, []
        for number, storage in enumerate(self._storages):
            # A file whose times are unknown begins with the one before it.
            begin = begin if storage.span is None else storage.span[0]
            begins.append((begin, number))
        later = deque(sorted(begins))
        # Next message of each file that is being read.
        heads: list[tuple[int, int, Recorded, Iterator[Recorded]]] = []
        while later or heads:
            if later and (not heads or later[0][0] <= heads[0][0]):
                _, number = later.popleft()
                stream = self._storages[number].messages(part)
            else:
                _, number, message, stream = heapq.heappop(heads)
                yield message
            following = next(stream, None)
            if following is not None:
                heapq.heappush(heads, (following.time, number, following, stream))

    def _unpack(self, file: Path) -> Path:
        if file.suffix != PACKED:
            return file
        check_regular(file, "bag")
        with refusing(f"cannot unpack bag {file}"):
            self._folder = self._folder or tempfile.TemporaryDirectory(prefix="uw_visibility_")
            unpacked = Path(self._folder.name) / file.stem
            note = unpack_file(file, unpacked)
        if note:
            self._notes.append(note)
        return unpacked

    def _merge_channels(self) -> dict[str, Channel]:
        merged: dict[str, Channel] = {}
        for channel in (c for s in self._storages for c in s.channels):
            first = merged.get(channel.topic)
            if first is None:
                merged[channel.topic] = channel
            elif first.type == channel.type:
                count = None
                if first.count is not None and channel.count is not None:
                    count = first.count + channel.count
                best = first if first.format else channel
                merged[channel.topic] = replace(best, count=count)
            else:
                self._notes.append(
                    f"{printable(channel.topic)} has a second type, {printable(channel.type)}"
                )
        return merged


def find_files(path: Path) -> Layout:
    """Find the files of a recording: a ROS 2 folder, one of its files, or a ROS 1 file.

    Raises `InputError` if there is no recording; `UnreadableError` if all its files are missing.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        reason = "it is missing" if isinstance(error, FileNotFoundError) else error
        raise InputError(f"cannot read bag {path}: {reason}") from error
    if not stat.S_ISDIR(mode):
        check_regular(path, "bag")
        return Layout([path])
    try:
        about = read_document(path / "metadata.yaml", "metadata")["rosbag2_bagfile_information"]
        packed = str(about.get("compression_mode", "")).lower() == "message"
        expected = {}
        for topic in about.get("topics_with_message_count", []):
            expected[str(topic["topic_metadata"]["name"])] = _count(topic["message_count"])
        # Names only: a path could lead out of the bag.
        names = [Path(str(name)).name for name in about["relative_file_paths"]]
    except (InputError, KeyError, TypeError, AttributeError) as error:
        return _without_metadata(path, error)
    there = {file.name: file for file in _files(path)}
    missing = [name for name in names if name not in there]
    if len(missing) == len(names):
        # Files with other names are read.
        files = [file for file in there.values() if suffix(file) in SUFFIXES]
        if not files:
            raise UnreadableError(f"cannot read bag {path}: its files are missing")
        return Layout(files, packed, expected, ["the files have other names than metadata.yaml"])
    notes = [f"missing files: {', '.join(map(printable, missing))}"] if missing else []
    files = [path / name for name in names if name not in missing]
    return Layout(files, packed, expected, notes)


def _count(value: object) -> int:
    if not isinstance(value, int) or value < 0:
        raise TypeError("the number of messages is not a count")
    return value


def _files(path: Path) -> list[Path]:
    with refusing(f"cannot read bag {path}"):
        return sorted((file for file in path.iterdir() if file.is_file()), key=_place)


def _place(file: Path) -> tuple[list[str | int], str]:
    """Return a key to sort by name, with numbers by their value: dive_10 follows dive_9."""
    parts = re.split(r"([0-9]+)", file.name)
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], file.name


def suffix(file: Path) -> str:
    """Return the suffix of a file, without that of its compression."""
    return Path(file.stem).suffix if file.suffix == PACKED else file.suffix


def _without_metadata(path: Path, error: Exception) -> Layout:
    files = [file for file in _files(path) if suffix(file) in SUFFIXES]
    if not files:
        raise InputError(
            f"cannot read bag {path}: it has no metadata.yaml and no recording"
        ) from error
    # ROS 1 bags have no metadata.yaml.
    notes = ["metadata.yaml is missing or damaged"] if files[0].suffix != ".bag" else []
    return Layout(files, notes=notes)
