# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Result folder: written aside, named when complete, never over another one."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from uw_visibility.config.documents import read_document
from uw_visibility.errors import InputError, refusing

# Every result has this file; a folder without it is none of ours.
MARK = "replay.json"
PARTIAL = ".partial"
OLD = ".old"
# What is opened before the state is written, and that before the first frame. The recording of
# results is in a folder of its own until it is complete.
FIRST = {
    "frames.csv", "frames.csv-metadata.json", "frames.jsonl", "results", "results.mcap",
    MARK + ".new",
}


def partial_of(target: Path) -> Path:
    """Return the folder of a partial result."""
    return target.with_name(target.name + PARTIAL)


def check_target(target: Path, force: bool) -> None:
    """Refuse a folder that must not be overwritten.

    Parameters
    ----------
    target : Path
        Folder of a result to be.
    force : bool
        Whether a result there may be replaced.

    Raises
    ------
    InputError
        If there is another result, or something else.
    """
    if not target.exists() and not target.is_symlink():
        return
    if target.is_dir() and not target.is_symlink() and not any(target.iterdir()):
        return
    refuse_to_replace(target, (target / MARK).is_file() and not target.is_symlink(), force)


def refuse_to_replace(target: Path | str, result: bool, force: bool) -> None:
    """Refuse to replace what is no result, or a result without force."""
    if not result:
        raise InputError(f"{target} exists already and is no replay: give another name")
    if not force:
        raise InputError(f"{target} exists already: give another name, or --force to replace")


def read_state(folder: Path) -> dict[str, Any]:
    """Read the state of a result: origin and completeness.

    Raises
    ------
    InputError
        If that cannot be read.
    """
    state = read_document(folder / MARK, "state")
    if not isinstance(state, dict):
        raise InputError(f"state {folder / MARK} holds no named values")
    return state


class ResultFolder:
    """Folder that a replay writes; it appears under its name when all is there.

    Parameters
    ----------
    target : Path
        Folder of the result.
    force : bool
        Whether a result there may be replaced.
    resume : bool
        Whether a partial result beside it is gone on from.

    Attributes
    ----------
    target : Path
    work : Path
        Folder to write to, beside the target.
    earlier : Path or None
        Folder of the partial result to go on from.

    Raises
    ------
    InputError
        If there is something that must not be overwritten, or the folder
        cannot be made.
    """

    def __init__(self, target: Path, *, force: bool = False, resume: bool = False) -> None:
        self.target = target
        self.work = partial_of(target)
        self._old = target.with_name(target.name + PARTIAL + OLD)
        self.earlier: Path | None = None
        check_target(target, force)
        with refusing(f"cannot make folder {self.work}"):
            self._make_room(force, resume)
            self.work.mkdir(parents=True)

    def state(self) -> dict[str, Any]:
        """State of the partial result.

        Raises
        ------
        InputError
            If that cannot be read.
        """
        if self.earlier is None:
            return {}
        try:
            return read_state(self.earlier)
        except (OSError, ValueError) as error:
            raise InputError(
                f"cannot go on from {self.earlier}: {error}; --force begins anew"
            ) from error

    def write_state(self, state: dict[str, Any]) -> None:
        """Write the state of the result."""
        text = json.dumps(state, indent=1, allow_nan=False)
        aside = self.work / (MARK + ".new")
        aside.write_text(text + "\n", encoding="utf-8")
        aside.replace(self.work / MARK)

    def refuse_earlier(self) -> None:
        """Put a partial result that cannot be gone on from back under its name."""
        shutil.rmtree(self.work)
        if self.earlier is not None:
            self.earlier.rename(self.work)
            self.earlier = None

    def forget_earlier(self) -> None:
        """Remove the partial result, all of which has been taken over."""
        if self.earlier is not None:
            shutil.rmtree(self.earlier)
            self.earlier = None

    def complete(self) -> None:
        """Rename the complete result to its target."""
        if self.target.is_dir():
            shutil.rmtree(self.target)
        self.work.rename(self.target)

    def _make_room(self, force: bool, resume: bool) -> None:
        # An older part that is still there was not taken over whole.
        if self._old.exists() and (resume or force):
            if self.work.exists():
                shutil.rmtree(self.work)
            self._old.rename(self.work)
        if not self.work.exists():
            return
        if resume and _never_begun(self.work):
            shutil.rmtree(self.work)
        elif resume:
            self.work.rename(self._old)
            self.earlier = self._old
        elif force:
            shutil.rmtree(self.work)
        else:
            raise InputError(
                f"{self.work} is a partial result: --resume goes on from it, --force begins anew"
            )


def _never_begun(folder: Path) -> bool:
    """Whether a run was ended by force before it answered a frame."""
    return folder.is_dir() and all(
        # A file that it was about to write whole has a name of its own (`aside_of`).
        entry.name in FIRST or (entry.name.startswith(".") and entry.suffix == PARTIAL)
        for entry in folder.iterdir())
