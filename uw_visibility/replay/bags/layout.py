# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Files and metadata of a recording."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import yaml

from uw_visibility.errors import InputError
from uw_visibility.replay.bags.indexed import SALVAGE

PACKED = ".zstd"


class UnreadableError(InputError):
    """Unreadable recording: it is there, but nothing of it can be read."""


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
    notes : list of str
        What is missing.
    """

    files: list[Path]
    packed_messages: bool = False
    expected: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def find_files(path: Path) -> Layout:
    """Find the files of a recording.

    Parameters
    ----------
    path : Path
        Folder of a ROS 2 bag, one of its files, or file of a ROS 1 bag.

    Returns
    -------
    Layout

    Raises
    ------
    InputError
        If there is no recording; `UnreadableError` if all its files are missing.
    """
    if not path.exists():
        raise InputError(f"cannot read bag {path}: it is missing")
    if path.is_file():
        return Layout([path])
    try:
        text = (path / "metadata.yaml").read_text(encoding="utf-8")
        about = yaml.safe_load(text)["rosbag2_bagfile_information"]
        packed = str(about.get("compression_mode", "")).lower() == "message"
        expected = {
            topic["topic_metadata"]["name"]: int(topic["message_count"])
            for topic in about.get("topics_with_message_count", [])
        }
        names = [Path(str(name)).name for name in about["relative_file_paths"]]
    except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        return _without_metadata(path, error)
    missing = [name for name in names if not (path / name).exists()]
    if len(missing) == len(names):
        raise UnreadableError(f"cannot read bag {path}: its files are missing")
    notes = [f"missing files: {', '.join(missing)}"] if missing else []
    files = [path / name for name in names if name not in missing]
    return Layout(files, packed, expected, notes)


def suffix(file: Path) -> str:
    """Return the suffix of a file, without that of its packing."""
    return Path(file.stem).suffix if file.suffix == PACKED else file.suffix


def _without_metadata(path: Path, error: Exception) -> Layout:
    files = sorted(file for file in path.iterdir() if suffix(file) in SALVAGE)
    if not files:
        raise InputError(
            f"cannot read bag {path}: it holds no metadata.yaml and no recording"
        ) from error
    # Folders of ROS 1 bags never have any.
    notes = ["metadata.yaml is missing or damaged"] if files[0].suffix != ".bag" else []
    return Layout(files, notes=notes)
