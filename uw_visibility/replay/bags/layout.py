# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Files and metadata of a recording."""

from __future__ import annotations

import stat
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from uw_visibility.config.documents import read_document
from uw_visibility.config.files import check_regular
from uw_visibility.errors import InputError, printable, refusing
from uw_visibility.replay.bags.indexed import SALVAGE

PACKED = ".zstd"


class UnreadableError(InputError):
    """Unreadable recording: it is there, but nothing of it can be read."""


class Named(NamedTuple):
    """Name and type of a topic."""

    topic: str
    type: str


@dataclass(frozen=True)
class Layout:
    """Files of a recording.

    Attributes
    ----------
    files : list of Path
        Those that are there, in the order of time.
    packed_messages : bool
        Whether each message is packed by itself.
    expected : dict of str to int
        Messages by topic, as the metadata counts them.
    types : dict of str to str
        Types of message by topic, as the metadata names them.
    notes : list of str
        What is missing.
    """

    files: list[Path]
    packed_messages: bool = False
    expected: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    types: dict[str, str] = field(default_factory=dict)

    def corrections(self, found: Mapping[str, str], known: Collection[str]) -> dict[str, Named]:
        """Return what topics should be called whose name or type is damaged in the files.

        Parameters
        ----------
        found : mapping of str to str
            Types by topic in the files.
        known : collection of str
            Common types of messages.

        Returns
        -------
        dict of str to Named
            Name and type by the metadata, by the name in the files; none where more
            than one name differs, since then it is not clear which is which.
        """
        corrected = {
            topic: Named(topic, self.types[topic]) for topic, kind in found.items()
            if kind not in known and self.types.get(topic, kind) in known
        }
        unknown = [topic for topic in found if topic not in self.types]
        lacking = [topic for topic in self.types if topic not in found and self.expected[topic]]
        if len(unknown) == len(lacking) == 1:
            corrected[unknown[0]] = Named(lacking[0], self.types[lacking[0]])
        return corrected


def find_files(path: Path) -> Layout:
    """Find the files of a recording.

    Parameters
    ----------
    path : Path
        Folder of a ROS 2 bag, one of its files, or file of a ROS 1 bag.

    Raises
    ------
    InputError
        If there is no recording; `UnreadableError` if all its files are missing.
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
        expected, types = {}, {}
        for topic in about.get("topics_with_message_count", []):
            name = str(topic["topic_metadata"]["name"])
            expected[name] = _count(topic["message_count"])
            types[name] = str(topic["topic_metadata"].get("type"))
        # A name with a path would lead out of the bag.
        names = [Path(str(name)).name for name in about["relative_file_paths"]]
    except (InputError, KeyError, TypeError, AttributeError) as error:
        return _without_metadata(path, error)
    missing = [name for name in names if not _is_there(path / name)]
    if len(missing) == len(names):
        # What is there under other names is read all the same.
        files = _files(path)
        if not files:
            raise UnreadableError(f"cannot read bag {path}: its files are missing")
        return Layout(
            files, packed, expected, ["the files have other names than metadata.yaml"], types
        )
    notes = [f"missing files: {', '.join(map(printable, missing))}"] if missing else []
    files = [path / name for name in names if name not in missing]
    return Layout(files, packed, expected, notes, types)


def _count(value: object) -> int:
    if not isinstance(value, int) or value < 0:
        raise TypeError("a number of messages is none")
    return value


def _is_there(file: Path) -> bool:
    try:
        return file.is_file()
    except (OSError, ValueError):
        # Names that no file system takes.
        return False


def _files(path: Path) -> list[Path]:
    with refusing(f"cannot read bag {path}"):
        return sorted(f for f in path.iterdir() if suffix(f) in SALVAGE and _is_there(f))


def suffix(file: Path) -> str:
    """Return the suffix of a file, without that of its packing."""
    return Path(file.stem).suffix if file.suffix == PACKED else file.suffix


def _without_metadata(path: Path, error: Exception) -> Layout:
    files = _files(path)
    if not files:
        raise InputError(
            f"cannot read bag {path}: it holds no metadata.yaml and no recording"
        ) from error
    # Folders of ROS 1 bags never have any.
    notes = ["metadata.yaml is missing or damaged"] if files[0].suffix != ".bag" else []
    return Layout(files, notes=notes)
