# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings and results in object stores, by fsspec: fetched, worked on here, and stored."""

from __future__ import annotations

import importlib
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, TypeAlias

from uw_visibility.config.files import PARTIAL, new_name
from uw_visibility.errors import InputError, needing, refusing
from uw_visibility.replay.results.folder import (
    DAY,
    DAY_MARK,
    MARK,
    RESULT,
    check_target,
    refuse_to_replace,
)

Place: TypeAlias = Path | str
"""Where a recording or a result is: a path of this machine, or a URL."""

PREFIX = "uw_visibility-"
SCHEMES = (
    "s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "https", "http", "sftp", "ssh", "file",
    "memory",
)
"""Kinds of store. fsspec has others that run what they read, or read one place by another."""
LARGEST = 1 << 40
"""Bytes of a recording that is fetched; a day of pairs of two megapixels has no more."""
BLOCK = 1 << 20


def place(text: str) -> Place:
    """Return the place that a text names: a URL such as ``s3://bucket/dive``, or a path."""
    if "://" not in text:
        return Path(text)
    check_urls([text])
    return text.rstrip("/")


def check_urls(places: Iterable[Place]) -> None:
    """Refuse URLs of other stores than `SCHEMES`, and those that hold credentials.

    Places are shown in reports, errors and lists of processes, which are no place for secrets.
    """
    for url in (where for where in places if isinstance(where, str)):
        scheme, _, rest = url.partition("://")
        # Behind :: fsspec takes another URL.
        if scheme.lower() not in SCHEMES or "::" in rest:
            shown = scheme if re.fullmatch(r"[\w+.-]*", scheme) else "a URL within a URL"
            raise InputError(
                f"{shown} is no kind of store that is used: give one of {', '.join(SCHEMES)}")
        # A name alone is none: abfs has containers before @, and ssh users. HTTP has tokens
        # there, and behind ?. A password may hold slashes.
        web = scheme.lower() in ("http", "https")
        if re.match(r"(?s)[^/]*:.*@|.*[?#].*=" + (r"|[^/]*@|.*\?" if web else ""), rest):
            raise InputError(
                f"a URL of {scheme} holds credentials, or what may be some (before @, behind ?): "
                "leave them out, and give them by the store's settings, see docs/cluster.md")


def child(folder: Place, name: str) -> Place:
    """Return the place of a name within a folder."""
    return folder / name if isinstance(folder, Path) else f"{folder}/{name}"


def absolute(where: Place) -> Place:
    """Return a place that is valid in other processes."""
    return where.resolve() if isinstance(where, Path) else where


def expand(places: Iterable[Place]) -> list[Place]:
    """Return places, and what URLs with wildcards among them name, which no shell expands.

    Raises `InputError` if one names nothing, or its store cannot be read.
    """
    found: list[Place] = []
    for where in places:
        if isinstance(where, Path) or "*" not in where:
            found.append(where)
            continue
        with _opened(where) as (store, path):
            names = sorted(store.glob(path))
        if not names:
            raise InputError(f"nothing is at {where}")
        # Paths of some stores begin with a slash, those of others do not.
        before = where.removesuffix(path.lstrip("/"))
        found += [
            str(store.unstrip_protocol(name)) if before == where else before + name.lstrip("/")
            for name in names]
    return found


def recording_name(bag: Place) -> str:
    """Return the name of a recording: that of its folder, or of its file without the format."""
    if isinstance(bag, Path):
        # A folder's name may have dots in it, a file's ends with its format.
        return bag.resolve().name if bag.is_dir() else bag.stem
    with _opened(bag) as (store, path):
        return PurePosixPath(bag).name if store.isdir(path) else PurePosixPath(bag).stem


@contextmanager
def recording_here(bag: Place) -> Iterator[Path]:
    """Yield the path of a recording; one at a URL is fetched to a temporary folder."""
    if isinstance(bag, Path):
        yield bag
        return
    with tempfile.TemporaryDirectory(prefix=PREFIX) as scratch:
        here = Path(scratch) / PurePosixPath(bag).name
        with _opened(bag) as (store, path):
            _fetch(store, path, here)
        if not here.exists():
            raise InputError(f"cannot read bag {bag}: it is missing")
        yield here


@contextmanager
def recordings_here(bags: Sequence[Place]) -> Iterator[list[Path]]:
    """Fetch several recordings, those that wildcards stand for too, as `recording_here` does.

    Raises `InputError` if one cannot be fetched.
    """
    with ExitStack() as fetched:
        yield [fetched.enter_context(recording_here(bag)) for bag in expand(bags)]


@contextmanager
def result_here(target: Place, *, force: bool = False) -> Iterator[Path]:
    """Yield the folder to make for a result; for a URL, store it when it is complete.

    Where something else has appeared at the URL meanwhile, it is stored beside (`InputError`).
    """
    if isinstance(target, Path):
        yield target
        return
    with tempfile.TemporaryDirectory(prefix=PREFIX) as scratch:
        folder = Path(scratch) / PurePosixPath(target).name
        yield folder
        with _opened(target, "write") as (store, path):
            try:
                for name in _replaced(store, path, target, force):
                    store.rm_file(f"{path}/{name}")
            except InputError as error:
                kept = f".{new_name()}{PARTIAL}"
                _put(store, path + kept, folder)
                raise InputError(f"{error}; the result is in {target}{kept}") from error
            _put(store, path, folder)


@contextmanager
def results_here(output: Place, results: Sequence[Place], names: Sequence[str]) -> Iterator[Path]:
    """Yield the folder of several results; for a URL, fetch files of each, and store new files."""
    if isinstance(output, Path):
        yield output
        return
    with tempfile.TemporaryDirectory(prefix=PREFIX) as scratch:
        folder = Path(scratch) / PurePosixPath(output).name
        folder.mkdir()
        for result in results:
            here = folder / PurePosixPath(result).name
            here.mkdir()
            with _opened(result) as (store, path):
                _fetch_files(store, {f"{path}/{name}": here / name for name in names})
        yield folder
        with _opened(output, "write") as (store, path):
            for written in sorted(folder.iterdir()):
                if written.is_file():
                    store.put_file(str(written), f"{path}/{written.name}")


@contextmanager
def files_here(result: Place, names: Iterable[str]) -> Iterator[Path]:
    """Yield a folder that has some files of a result; for a URL, fetch them.

    Raises `InputError` if one is missing there.
    """
    if isinstance(result, Path):
        yield result
        return
    with tempfile.TemporaryDirectory(prefix=PREFIX) as scratch:
        with _opened(result) as (store, path):
            _fetch_files(store, {f"{path}/{name}": Path(scratch) / name for name in names})
        yield Path(scratch)


def check_place(target: Place, force: bool) -> None:
    """Refuse a place that must not be overwritten, as `check_target` does."""
    if isinstance(target, Path):
        check_target(target, force)
        return
    with _opened(target) as (store, path):
        _replaced(store, path, target, force)


def exists(where: Place) -> bool:
    """Return whether something is at a place.

    Raises `InputError` if its store cannot be read.
    """
    if isinstance(where, Path):
        return where.exists()
    with _opened(where) as (store, path):
        return bool(store.exists(path))


def _replaced(store: Any, path: str, target: str, force: bool) -> list[str]:
    """Return the names of all that is at a place, where it may be replaced; the mark first."""
    names = [
        # The place may be a file itself.
        PurePosixPath(name).relative_to(path).as_posix() for name in store.find(path)]
    if not names:
        return []
    products = DAY if DAY_MARK in names else RESULT
    refuse_to_replace(target, products, products.mark in names, force)
    products.check_names(target, names, marked=True)
    return sorted(names, key=lambda name: name != products.mark)


def _fetch(store: Any, path: str, here: Path) -> None:
    if not store.isdir(path):
        if store.exists(path):
            _fetch_files(store, {path: here})
        return
    files = {}
    # A recording has no folders within; a page of the web leads to any number of others.
    for name in store.find(path, maxdepth=1):
        relative = PurePosixPath(name).relative_to(path)
        # Whoever names the objects must not choose where on this machine they go.
        if ".." in relative.parts:
            raise InputError(f"the store has an object outside of its folder: {name!r}")
        files[name] = here / relative
    if files:
        here.mkdir()
    _fetch_files(store, files)


def _fetch_files(store: Any, files: Mapping[str, Path]) -> None:
    """Fetch files, as many bytes as there may be."""
    folder = Path(tempfile.gettempdir())
    most = min(LARGEST, shutil.disk_usage(folder).free // 2)
    too_much = InputError(
        f"{next(iter(files), '')} and what is beside it has more than {most / 1e9:.3g} GB, which "
        f"is half of the room in {folder} or the most that is fetched: name a folder with more "
        "room in TMPDIR, or fetch it yourself and give the folder")
    if sum(store.size(name) or 0 for name in files) > most:
        raise too_much
    for name, here in files.items():
        with store.open(name, "rb") as source, here.open("wb") as target:
            while block := source.read(BLOCK):
                most -= len(block)
                if most < 0:
                    raise too_much
                target.write(block)


def _put(store: Any, path: str, folder: Path) -> None:
    """Store a result; its mark last, so that what has it is complete."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    for file in sorted(files, key=lambda file: file == folder / MARK):
        name = f"{path}/{file.relative_to(folder).as_posix()}"
        store.makedirs(name.rpartition("/")[0], exist_ok=True)
        store.put_file(str(file), name)


@contextmanager
def _opened(url: Place, work: str = "read") -> Iterator[tuple[Any, str]]:
    """Yield the store of a URL, and the path within it, to read or to write."""
    check_urls([url])
    with needing("stores", str(url)):
        fsspec = importlib.import_module("fsspec.core")
    with refusing(f"cannot use {url}", Exception):
        store, path = fsspec.url_to_fs(str(url))
    # What was listed before may have changed since.
    store.invalidate_cache()
    with refusing(f"cannot {work} {url}", Exception):
        yield store, str(path)
