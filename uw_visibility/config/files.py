# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""File access: regular files within a size are read, and results appear whole or not at all."""

from __future__ import annotations

import errno
import fcntl
import glob
import os
import shutil
import stat
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from uw_visibility.errors import InputError, refusing

PARTIAL = ".partial"
# File systems allow 255 bytes to a name.
LONGEST_STEM = 60


def read_regular(path: str | Path, most: int, what: str = "file") -> bytes:
    """Read a regular file.

    A pipe or a device would make the reader wait for ever, or never end.

    Parameters
    ----------
    path : str or Path
        The file.
    most : int
        Bytes that are read at most.
    what : str
        What errors call the file.

    Raises
    ------
    InputError
        If it cannot be read, is no regular file, or is larger; names the file.
    """
    with refusing(f"cannot read {what} {path}"):
        check_regular(path, what)
        # Between the look and the opening a pipe may have come into its place.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise InputError(f"{what} {path} is no regular file: give one")
            # Not its size: some files, as those of /proc, state none.
            content = file.read(most + 1)
    if len(content) > most:
        raise InputError(f"{what} {path} is larger than {most} bytes: give a smaller one")
    return content


def check_regular(path: str | Path, what: str = "file") -> None:
    """Refuse what is no regular file, without opening it.

    Raises
    ------
    InputError
        If it is missing, or a folder, a pipe, a socket or a device.
    """
    # ValueError: names that hold a null character.
    with refusing(f"cannot read {what} {path}", OSError, ValueError):
        mode = Path(path).stat().st_mode
    if stat.S_ISDIR(mode):
        raise InputError(f"cannot read {what} {path}: {os.strerror(errno.EISDIR)}")
    if not stat.S_ISREG(mode):
        raise InputError(f"{what} {path} is no regular file: give one")


def write_whole(path: str | Path, content: bytes | str) -> None:
    """Write a file that appears under its name when all of it is on the disk.

    Parameters
    ----------
    path : str or Path
        The file; an older one is replaced.
    content : bytes or str
        Text is encoded as UTF-8.

    Raises
    ------
    InputError
        If it cannot be written, as on a full disk; an older file is left as it was.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    with refusing(f"cannot write {path}", OSError, ValueError):
        # A link is kept, and what it leads to is replaced.
        target = Path(os.path.realpath(path))
        if target.exists() and not target.is_file():
            raise InputError(f"cannot write {path}: it is no regular file")
        aside = aside_of(target)
        try:
            with aside.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            aside.replace(target)
        finally:
            with suppress(OSError):
                aside.unlink(missing_ok=True)


def aside_of(target: Path) -> Path:
    """Return a new name beside a file or folder, hidden, to write it under."""
    return target.with_name(f".{target.name[:LONGEST_STEM]}.{uuid.uuid4().hex[:12]}{PARTIAL}")


@contextmanager
def gathered(folder: Path, last: str, *, clear: bool = False) -> Iterator[Path]:
    """Folder to write results to, which come to their place when all of them are written.

    Parameters
    ----------
    folder : Path
        Their place; made where missing.
    last : str
        The file that says that results are complete: it goes first and comes last.
    clear : bool
        Whether whatever else is in the folder is removed.

    Raises
    ------
    InputError
        If something cannot be written, as on a full disk; what was there before is
        left as it was.
    """
    aside = folder / f".{uuid.uuid4().hex[:12]}{PARTIAL}"
    try:
        with refusing(f"cannot write to folder {folder}"):
            aside.mkdir(parents=True)
            for left in folder.glob(f".*{PARTIAL}"):
                # Of a run that was ended by force.
                if left != aside:
                    _remove(left)
            yield aside
            for entry in folder.iterdir():
                if entry.name == last or (clear and entry not in (aside, lock_of(folder))):
                    _remove(entry)
            files = sorted(aside.iterdir(), key=lambda file: (file.name == last, file.name))
            for file in files:
                file.replace(folder / file.name)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _remove(entry: Path) -> None:
    if entry.is_dir() and not entry.is_symlink():
        shutil.rmtree(entry)
    else:
        entry.unlink()


def lock_of(target: Path) -> Path:
    """Return where the lock of a folder or file of results is: beside it, if that can be."""
    place = Path(os.path.realpath(target))
    name = f".{place.name[:LONGEST_STEM]}.lock"
    # Whoever may write to a folder may not always to the one that it is in.
    beside = not place.is_dir() or os.access(place.parent, os.W_OK | os.X_OK)
    return (place.parent if beside else place) / name


@contextmanager
def sole_writer(target: Path) -> Iterator[None]:
    """Keep a folder or file of results to this process; its parent is made where missing.

    Raises
    ------
    InputError
        If another process writes it, or the place cannot be written to.
    """
    with refusing(f"cannot write to folder {target.parent}", OSError, ValueError):
        lock = lock_of(target)
        lock.parent.mkdir(parents=True, exist_ok=True)
        try:
            descriptor = _locked(lock)
        except BlockingIOError as error:
            raise InputError(
                f"another run writes {target}: wait for its end, or give another name"
            ) from error
    try:
        # Whoever was ended by force left these.
        for left in lock.parent.glob(f"{glob.escape(lock.stem)}.*{PARTIAL}"):
            _remove(left)
        yield
    finally:
        # While it is held: whoever opened it meanwhile sees that it is gone, and tries again.
        with suppress(OSError):
            lock.unlink()
        os.close(descriptor)


def _locked(lock: Path) -> int:
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(descriptor).st_ino == lock.stat().st_ino:
                return descriptor
        except FileNotFoundError:
            # The run before ended between the two calls.
            pass
        except BlockingIOError:
            os.close(descriptor)
            raise
        except OSError as error:
            if error.errno in (errno.ENOTSUP, errno.ENOLCK, errno.ENOSYS):
                # Some network file systems know no locks: work goes on without one.
                return descriptor
            os.close(descriptor)
            raise
        os.close(descriptor)
