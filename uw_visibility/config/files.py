# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reading of files within limits; atomic writing of results, which replace only earlier ones."""

from __future__ import annotations

import errno
import fcntl
import glob
import os
import re
import stat
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from uw_visibility.errors import InputError, refusing

PARTIAL = ".partial"
WORK_MARK = ".uw_visibility"
"""Mark of the temporary folders in which results are written."""
# File systems limit names to 255 bytes.
LONGEST_STEM = 60
# Random digits in the names of temporary files and folders (`aside_of`).
_DIGITS = 12
_ASIDE = re.compile(rf"\.(.+)\.[0-9a-f]{{{_DIGITS}}}{re.escape(PARTIAL)}")
# Bytes of a mark that are searched for `keys`.
_MARK_BYTES = 1 << 16


@dataclass(frozen=True)
class Products:
    """Files that a command writes to a folder; all others in it are foreign.

    mark: file that every such folder has.
    files: patterns of the others, relative to the folder; a folder in it ends with ``/``.
    what: description of a folder without the mark in errors, such as ``no replay``.
    keys: texts, one of which the mark contains; empty if the mark's name is enough.
    """

    mark: str
    files: tuple[str, ...]
    what: str
    keys: tuple[str, ...] = ()

    def includes(self, name: str) -> bool:
        """Return whether a name, relative to the folder, is that of a product."""
        *parents, last = name.split("/")
        aside = _ASIDE.fullmatch(last)
        parts = [*parents, last if aside is None else aside[1]]
        return any(
            len(pattern) == len(parts) and all(map(fnmatchcase, parts, pattern))
            for pattern in (text.split("/") for text in (glob.escape(self.mark), *self.files)))

    def marks(self, folder: Path) -> bool:
        """Return whether a folder, which must not be a link, has the mark."""
        mark = folder / self.mark
        if folder.is_symlink() or mark.is_symlink() or not mark.is_file():
            return False
        with mark.open("rb") as file:
            text = file.read(_MARK_BYTES)
        return not self.keys or any(key.encode() in text for key in self.keys)

    def check(self, folder: Path) -> None:
        """Refuse a folder that must not be removed: without the mark, or with a foreign file."""
        self.check_names(folder, _names(folder), self.marks(folder))

    def check_names(self, folder: Path | str, names: Iterable[str], marked: bool) -> None:
        """Refuse a folder, also one of a store, as `check` does, by all names in it."""
        listed = list(names)
        if listed and not marked:
            raise InputError(f"{folder} exists already and is {self.what}: give another name")
        for name in listed:
            if not self.includes(name):
                raise InputError(
                    f"{folder}/{name.rstrip('/@')} is not a result of this program: "
                    "move it, or give another name")

    def remove(self, folder: Path) -> None:
        """Remove a folder, each of its files by name; an empty one needs no mark.

        A folder with a foreign file is refused. A file that appears meanwhile is kept (OSError).
        """
        names = list(_names(folder))
        self.check_names(folder, names, self.marks(folder))
        # The mark is the last file removed, so that the remains of a killed run are recognised.
        for name in sorted(names, reverse=True, key=lambda name: [
            (part != self.mark, part) for part in name.rstrip("/").split("/")
        ]):
            path = folder / name
            if name.endswith("/"):
                path.rmdir()
            else:
                path.unlink()
        folder.rmdir()

    def check_room(self, folder: Path, *, force: bool) -> None:
        """Refuse to replace files by products; with `force`, refuse for foreign files only."""
        there = self.present(folder)
        if not there:
            return
        # A link to a folder keeps its place: only files in it are replaced.
        marked = self.marks(Path(os.path.realpath(folder)))
        for entry in there:
            if entry.is_symlink() or not entry.is_file() or not marked:
                raise InputError(
                    f"{entry} exists already and is {self.what}: move it, or give another name")
        if not force:
            raise InputError(
                f"{there[0]} exists already: give another name, or --force to replace")

    def present(self, folder: Path) -> list[Path]:
        """Return the products in a folder, the mark first."""
        there = [path for path in folder.iterdir() if self.includes(path.name)] \
            if folder.is_dir() else []
        return sorted(there, key=lambda path: (path.name != self.mark, path.name))


def _names(folder: Path, within: str = "") -> Iterator[str]:
    """Yield all names in a folder, those of folders with ``/``, those of links with ``@``."""
    if folder.is_symlink() or not folder.is_dir():
        yield "@"
        return
    with os.scandir(folder) as found:
        entries = sorted(found, key=lambda entry: entry.name)
    for entry in entries:
        name = within + entry.name
        if entry.is_dir(follow_symlinks=False):
            yield f"{name}/"
            yield from _names(Path(entry.path), f"{name}/")
        else:
            # Only regular files are products.
            yield name if entry.is_file(follow_symlinks=False) else f"{name}@"


def refuse_inputs(inputs: Iterable[Path | str | None], places: Iterable[Path | str]) -> None:
    """Refuse to replace places that contain an input of the run; paths or URLs."""
    taken = [(place, _parts(place)) for place in places]
    for given in inputs:
        if given is None:
            continue
        parts = _parts(given)
        for place, end in taken:
            if parts[: len(end)] == end:
                raise InputError(
                    f"{place} would replace the input {given}: give the results another name")


def _parts(place: Path | str) -> tuple[str, ...]:
    text = str(place).removeprefix("file://")
    if "://" in text:
        return tuple(text.rstrip("/").split("/"))
    return Path(os.path.realpath(text)).parts


def identity(folder: Path) -> tuple[int, int] | None:
    """Return device and inode of a folder that is not empty; None otherwise."""
    if not folder.is_dir() or not any(folder.iterdir()):
        return None
    status = folder.stat()
    return status.st_dev, status.st_ino


def read_regular(path: str | Path, most: int, what: str = "file") -> bytes:
    """Read a regular file.

    A pipe or a device could block the reader, or have no end.

    most: largest size, bytes.
    Raises `InputError`, which names the file, if it cannot be read, is not regular, or is larger.
    """
    with refusing(f"cannot read {what} {path}"):
        check_regular(path, what)
        # The file may have been replaced by a pipe since the check.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise InputError(f"{what} {path} is no regular file: give one")
            # The stated size is not used: files in /proc state 0.
            content = file.read(most + 1)
    if len(content) > most:
        raise InputError(f"{what} {path} is larger than {most} bytes: give a smaller one")
    return content


def check_regular(path: str | Path, what: str = "file") -> None:
    """Refuse anything but a regular file, without opening it."""
    # ValueError: names with a null character.
    with refusing(f"cannot read {what} {path}", OSError, ValueError):
        mode = Path(path).stat().st_mode
    if stat.S_ISDIR(mode):
        raise InputError(f"cannot read {what} {path}: {os.strerror(errno.EISDIR)}")
    if not stat.S_ISREG(mode):
        raise InputError(f"{what} {path} is no regular file: give one")


def write_whole(path: str | Path, content: bytes | str) -> None:
    """Write a file that appears under its name when all of it is on the disk.

    Raises `InputError` if it cannot be written, as on a full disk; an older file is unchanged then.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    with refusing(f"cannot write {path}", OSError, ValueError):
        # A symbolic link is kept; its target is replaced.
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
    """Return a unique hidden name beside a file or folder, to write under."""
    return target.with_name(f".{target.name[:LONGEST_STEM]}.{new_name()}{PARTIAL}")


def new_name() -> str:
    """Return a random name, which is unique."""
    return uuid.uuid4().hex[:_DIGITS]


@contextmanager
def work_folder(folder: Path, products: Products) -> Iterator[Path]:
    """Make a temporary folder for results, and remove it with its remains at the end."""
    folder.mkdir(parents=True)
    try:
        (folder / WORK_MARK).touch()
        yield folder
    finally:
        with suppress(OSError, InputError):
            products.remove(folder)


@contextmanager
def gathered(folder: Path, products: Products, *, force: bool) -> Iterator[Path]:
    """Yield a temporary folder; its files are moved to `folder` when all are written.

    Earlier products there are replaced (with `force`), other files are kept. The mark shows that
    results are complete: it is removed first and moved last. If something cannot be written, or a
    foreign file has appeared under the name of a result (`InputError`), nothing is replaced.
    """
    work = Products(WORK_MARK, (products.mark, *products.files), "no folder of an unfinished run")
    name = new_name()
    with refusing(f"cannot write to folder {folder}"):
        _tidy(folder, "", work)
        with work_folder(folder / f".{name}{PARTIAL}", work) as aside:
            yield aside
            try:
                work.check(aside)
                products.check_room(folder, force=force)
            except InputError as error:
                kept = aside.rename(folder / f"{name}{PARTIAL}")
                raise InputError(f"{error}; the results are in {kept}") from error
            for entry in products.present(folder):
                entry.unlink()
            for file in reversed(products.present(aside)):
                file.replace(folder / file.name)


def replace_folder(
    work: Path, target: Path, products: Products, before: tuple[int, int] | None
) -> None:
    """Rename a folder of results to its target; earlier ones of identity `before` are removed."""
    check_replaced(target, products, before)
    if identity(target) is None:
        work.rename(target)
        return
    old = target.rename(aside_of(target))
    try:
        work.rename(target)
    except OSError:
        old.rename(target)
        raise
    products.remove(old)


def check_replaced(target: Path, products: Products, before: tuple[int, int] | None) -> None:
    """Refuse a target that is neither empty nor the folder of identity `before`."""
    found = identity(target)
    other = target.is_symlink() or (target.exists() and not target.is_dir())
    if other or found not in (None, before):
        raise InputError(f"another file or folder has appeared at {target} meanwhile: move it")
    if found is not None:
        products.check(target)


def _tidy(folder: Path, stem: str, *kinds: Products) -> None:
    """Remove hidden temporary folders of killed runs."""
    for left in folder.glob(f"{glob.escape(stem)}.{'[0-9a-f]' * _DIGITS}{PARTIAL}"):
        for products in kinds:
            with suppress(InputError, OSError):
                if products.marks(left):
                    products.remove(left)


def lock_of(target: Path) -> Path:
    """Return the lock of a folder or file of results: beside it if possible, otherwise in it."""
    place = Path(os.path.realpath(target))
    name = f".{place.name[:LONGEST_STEM]}.lock"
    # The parent folder may be read-only.
    beside = not place.is_dir() or os.access(place.parent, os.W_OK | os.X_OK)
    return (place.parent if beside else place) / name


@contextmanager
def sole_writer(target: Path, *left: Products) -> Iterator[None]:
    """Lock a folder or file of results for this process; create its parent if missing.

    Hidden temporary folders of killed runs beside it that hold the products `left` are removed.
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
        _tidy(lock.parent, lock.stem, *left)
        yield
    finally:
        # Unlinked while locked, so that another process that has opened it tries again.
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
            # The previous run has removed it between the two calls.
            pass
        except BlockingIOError:
            os.close(descriptor)
            raise
        except OSError as error:
            if error.errno in (errno.ENOTSUP, errno.ENOLCK, errno.ENOSYS):
                # Some network file systems have no locks: continue without one.
                return descriptor
            os.close(descriptor)
            raise
        os.close(descriptor)
