# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Result folder: written beside the target, renamed when complete, never over another one."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uw_visibility.config.documents import read_document
from uw_visibility.config.files import PARTIAL, Products, check_replaced, identity, replace_folder
from uw_visibility.errors import InputError, refusing

# File that marks a result folder.
MARK = "replay.json"
TABLE = "frames.csv"
MESSAGES = "results.mcap"
DAY_MARK = "transects.json"
"""File that marks a folder of several results."""
OLD = ".old"
# Files that exist before the first frame. Messages are recorded in a separate folder until they
# are complete.
FIRST = {
    "frames.csv", "frames.csv-metadata.json", "frames.jsonl", "results", "results.mcap",
    MARK, MARK + ".new",
}
TABLES = ("frames.csv", "frames.csv-metadata.json", "frames.geojson", "frames.nc", "frames.parquet")
RESULT = Products(
    MARK, (
        *TABLES, *FIRST, "timings.csv", "report.html", "video.mp4", "fit_*.json",
        "images/", "images/frame_[0-9]*.png",
        "results/", "results/results.mcap", "results/metadata.yaml"),
    "no replay")
"""Files of a complete or partial result."""
DAY = Products(DAY_MARK, ("index.html", *TABLES), "no replay of several recordings")
"""Files for several recordings, beside a folder for the result of each."""


def partial_of(target: Path) -> Path:
    """Return the folder of a partial result."""
    return target.with_name(target.name + PARTIAL)


def partial_refused(partial: Path) -> InputError:
    """Return the error for a partial result without --resume and --force."""
    return InputError(
        f"{partial} is a partial result: --resume continues it, --force starts over")


def places_of(target: Path) -> list[Path]:
    """Return all folders that a run with this target may replace.

    Raises `InputError` for the current folder and those that hold it.
    """
    here = Path.cwd()
    # Path.resolve raises an error for a link to itself.
    if Path(os.path.realpath(target)) in (here, *here.parents):
        raise InputError(
            f"{str(target)!r} is the current folder or holds it: give the results a folder of "
            "their own")
    partial = partial_of(target)
    return [target, partial, partial.with_name(partial.name + OLD)]


def check_target(target: Path, force: bool) -> None:
    """Refuse a folder that must not be overwritten."""
    if target.is_symlink():
        # A link to a result would be replaced, and the result kept.
        raise InputError(
            f"{target} is a symbolic link: give the folder that it points to, or another name")
    if not target.exists() or (target.is_dir() and not any(target.iterdir())):
        return
    several = (target / DAY_MARK).is_file()
    refuse_to_replace(target, RESULT.marks(target), several=several, force=force)
    RESULT.check(target)


def refuse_to_replace(target: Path | str, marked: bool, *, several: bool, force: bool) -> None:
    """Refuse to replace a folder that is not the result of one recording, or without `force`."""
    if several:
        raise InputError(f"{target} has the results of several recordings: give another name")
    if not marked:
        raise InputError(f"{target} exists already and is {RESULT.what}: give another name")
    if not force:
        raise InputError(f"{target} exists already: give another name, or --force to replace")


def check_names(names: Sequence[str]) -> None:
    """Refuse names of recordings whose results would overwrite each other."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"two bags are named {twice[0]}: replay them one by one")
    taken = {name + end for name in names for end in (PARTIAL, PARTIAL + OLD)}
    for name in names:
        if name in taken or name == MARK or DAY.includes(name):
            raise InputError(
                f"a bag is named {name}, like a file or folder beside its results: rename it, or "
                "replay it separately")


def read_state(folder: Path) -> dict[str, Any]:
    """Read the state of a result: origin and completeness.

    Raises `InputError` if it cannot be read.
    """
    state = read_document(folder / MARK, "state")
    if not isinstance(state, dict):
        raise InputError(f"state {folder / MARK} has no named values")
    return state


class ResultFolder:
    """Folder that a replay writes, which is renamed to its target when complete.

    work: folder to write to, beside the target.
    earlier: folder of the partial result to continue.
    """

    def __init__(self, target: Path, *, force: bool = False, resume: bool = False) -> None:
        self.target = target
        _, self.work, self._old = places_of(target)
        self.earlier: Path | None = None
        check_target(target, force)
        self._before = identity(target)
        with refusing(f"cannot make folder {self.work}"):
            self._make_room(force, resume)
            self.work.mkdir(parents=True)
            # At once, so that the folder of a killed run is recognised and can be removed.
            (self.work / MARK).touch()

    def write_state(self, state: dict[str, Any]) -> None:
        text = json.dumps(state, indent=1, allow_nan=False)
        aside = self.work / (MARK + ".new")
        aside.write_text(text + "\n", encoding="utf-8")
        aside.replace(self.work / MARK)

    def refuse_earlier(self) -> None:
        """Restore the name of a partial result that cannot be resumed."""
        RESULT.remove(self.work)
        if self.earlier is not None:
            self.earlier.rename(self.work)
            self.earlier = None

    def forget_earlier(self) -> None:
        """Remove the earlier partial result, which has been taken over completely."""
        if self.earlier is not None:
            RESULT.remove(self.earlier)
            self.earlier = None

    def check_complete(self) -> None:
        """Refuse to rename the result if something else appeared at its target meanwhile."""
        try:
            check_replaced(self.target, RESULT, self._before)
        except InputError as error:
            raise InputError(
                f"{error}; the result is in {self.work}, and --resume completes it"
            ) from error

    def complete(self) -> None:
        """Rename the complete result to its target."""
        replace_folder(self.work, self.target, RESULT, self._before)

    def _make_room(self, force: bool, resume: bool) -> None:
        touched = (self.work, self._old) if resume or force else (self.work,)
        there = [folder for folder in touched if folder.exists() or folder.is_symlink()]
        for folder in there:
            RESULT.check(folder)
        # An older part that still exists was not taken over completely.
        if self._old in there:
            if self.work in there:
                RESULT.remove(self.work)
            self._old.rename(self.work)
        if not self.work.exists():
            return
        if resume and _never_begun(self.work):
            RESULT.remove(self.work)
        elif resume:
            self.work.rename(self._old)
            self.earlier = self._old
        elif force:
            RESULT.remove(self.work)
        else:
            raise partial_refused(self.work)


def _never_begun(folder: Path) -> bool:
    """Return whether a run was killed before its first frame."""
    mark = folder / MARK
    return not (mark.is_file() and mark.stat().st_size) and all(
        # Temporary files have names by `aside_of`.
        entry.name in FIRST or (entry.name.startswith(".") and entry.suffix == PARTIAL)
        for entry in folder.iterdir())
