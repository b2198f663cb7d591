# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Files and metadata of a recording."""

from __future__ import annotations

import re
import stat
from dataclasses import dataclass, field
from pathlib import Path

from uw_visibility.config.documents import read_document
from uw_visibility.config.files import check_regular
from uw_visibility.errors import InputError, printable, refusing
from uw_visibility.replay.bags.indexed import SUFFIXES

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
    there = {file.name for file in _files(path)}
    missing = [name for name in names if name not in there]
    if len(missing) == len(names):
        # Files with other names are read.
        files = [file for file in _files(path) if suffix(file) in SUFFIXES]
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
