# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Folders of compiled kernels, and whose files may be run.

A kernel's file is code. It is run only where nobody but the user or root can have written
it, and written only where nobody else can exchange it; root trusts root alone.
"""

from __future__ import annotations

import functools
import logging
import os
import shutil
import stat
import tempfile
from pathlib import Path

from uw_visibility.compute.fingerprint import PACKAGE_FOLDER, source_of

# Other versions of a module's kernels that stay: another checkout's or another setting's.
KEPT_VERSIONS = 2

log = logging.getLogger(__name__)


def package_folder() -> Path:
    """Return the folder beside the sources, which an administrator may have filled."""
    return PACKAGE_FOLDER / "__pycache__" / "kernels"


@functools.cache
def writable_folder() -> Path | None:
    """Return the folder that kernels are kept in, or None where there is none.

    It is the first of ``uw_visibility`` in the user's ``NUMBA_CACHE_DIR``, the folder
    beside the sources, and ``uw_visibility`` in the user's folder for caches
    (``XDG_CACHE_HOME``, or else ``~/.cache``), that can be written to by the user and by
    nobody else.
    """
    chosen = _chosen_folder()
    for folder in filter(None, (chosen, package_folder(), _user_folder())):
        try:
            # Parents are made as the user makes folders; who may write into this one is ours.
            folder.mkdir(mode=_mode(0o755), parents=True, exist_ok=True)
            if not _trusted(folder):
                continue
            # Permissions do not tell: file systems can be read-only.
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError as error:
            if folder == chosen:
                warn_once(f"cannot write to NUMBA_CACHE_DIR {folder.parent}: {error.strerror}")
    warn_once(
        "compiled kernels cannot be kept, so that every start takes as long as the first: "
        f"neither {package_folder()} nor {_user_folder() or 'a home folder'} can be written to "
        "by this user alone; name a folder that can in NUMBA_CACHE_DIR"
    )
    return None


@functools.cache
def folders() -> tuple[Path, ...]:
    """Return where to look for kernels: what is written to, then what came with the package."""
    writable, package = writable_folder(), package_folder()
    found = [] if writable is None else [writable]
    chosen = writable is not None and writable == _chosen_folder()
    if not chosen and writable != package and package.is_dir() and _trusted(package):
        found.append(package)
    return tuple(found)


def read(file: Path) -> bytes | None:
    """Return what a file holds, or None where there is none that may be trusted."""
    try:
        with file.open("rb") as opened:
            # Asked of what was opened, which nobody can exchange any more.
            return opened.read() if _trusted(file, os.fstat(opened.fileno())) else None
    except FileNotFoundError:
        return None
    except PermissionError:
        warn_once(f"compiled kernels in {file.parents[1]} cannot be read by this user")
        return None


def write(file: Path, content: bytes) -> None:
    """Write a file of a version's folder at once and whole; make the folder.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    if not file.parent.exists():
        file.parent.mkdir(mode=_mode(0o755), exist_ok=True)
        _remove_old_versions(file.parent)
    descriptor, temporary = tempfile.mkstemp(dir=file.parent)
    try:
        with os.fdopen(descriptor, "wb") as opened:
            opened.write(content)
            # Of what was opened: a path may lead elsewhere by now.
            os.fchmod(opened.fileno(), _mode(0o644))
        Path(temporary).replace(file)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


@functools.cache
def warn_once(message: str) -> None:
    """Log a warning that many kernels have the cause for."""
    log.warning(message)


def _mode(mode: int) -> int:
    """Return permissions: for others to read only where root works for all users."""
    return mode if os.geteuid() == 0 else mode & 0o700


def _trusted(path: Path, status: os.stat_result | None = None) -> bool:
    status = status or path.stat()
    if status.st_uid not in (0, os.geteuid()):
        reason = f"belongs to another user (number {status.st_uid})"
    elif status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        reason = "can be written to by others (chmod go-w ends that)"
    else:
        return True
    place = path if path.is_dir() else path.parent
    warn_once(f"compiled kernels in {place} are not used: it, or a file in it, {reason}")
    return False


def _remove_old_versions(folder: Path) -> None:
    """Delete all but the newest other versions of a module's kernels, and what no module has."""
    module, _, version = folder.name.rpartition("-")
    others = [
        other for other in folder.parent.glob(f"{module}-{'[0-9a-f]' * len(version)}")
        if other != folder
    ]
    newest_first = sorted(others, key=_modified, reverse=True)
    old = newest_first[KEPT_VERSIONS:]
    if folder.parent == package_folder():
        # Other folders may serve other checkouts, with other modules.
        old += [
            other for other in folder.parent.iterdir()
            if source_of(other.name.rpartition("-")[0]) is None
        ]
    for other in old:
        shutil.rmtree(other, ignore_errors=True)


def _modified(folder: Path) -> float:
    """Return when a folder was written to, s, or 0 where another process has deleted it."""
    try:
        return folder.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def _chosen_folder() -> Path | None:
    # Not numba's own reading of it, which a file in the current folder may change.
    chosen = os.environ.get("NUMBA_CACHE_DIR", "")
    if chosen and not Path(chosen).is_absolute():
        warn_once(
            f"NUMBA_CACHE_DIR {chosen} is not used: it depends on the current folder, which may "
            "come from anywhere; give an absolute path"
        )
        return None
    return Path(chosen) / "uw_visibility" if chosen else None


def _user_folder() -> Path | None:
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    # Relative ones are to be ignored: XDG Base Directory Specification.
    if base.is_absolute():
        return base / "uw_visibility"
    try:
        home = Path.home()
    except RuntimeError:
        # A user without an entry, as in containers.
        return None
    return home / ".cache" / "uw_visibility" if home.is_absolute() else None


__all__ = ["folders", "package_folder", "read", "warn_once", "writable_folder", "write"]
