# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings and results in object stores by fsspec: downloaded, processed here, uploaded."""

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
    DAY_MARK,
    MARK,
    RESULT,
    check_target,
    refuse_to_replace,
)

Place: TypeAlias = Path | str
"""Location of a recording or a result: a path of this machine, or a URL."""

PREFIX = "uw_visibility-"
SCHEMES = (
    "s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "https", "http", "sftp", "ssh", "file",
    "memory",
)
"""Allowed stores. Others of fsspec run code that they read, or chain URLs."""
LARGEST = 1 << 40
"""Most bytes of a downloaded recording, enough for a day of pairs of two megapixels."""
BLOCK = 1 << 20


def place(text: str) -> Place:
    """Return the place for a text: a URL such as ``s3://bucket/dive``, or a path."""
    if "://" not in text:
        return Path(text)
    check_urls([text])
    return text.rstrip("/")


def check_urls(places: Iterable[Place]) -> None:
    """Refuse URLs of stores other than `SCHEMES`, and URLs with credentials.

    Places appear in reports, errors and process lists, which must not contain secrets.
    """
    for url in (where for where in places if isinstance(where, str)):
        scheme, _, rest = url.partition("://")
        # After :: fsspec expects another URL.
        if scheme.lower() not in SCHEMES or "::" in rest:
            shown = scheme if re.fullmatch(r"[\w+.-]*", scheme) else "a URL within a URL"
            raise InputError(
                f"{shown} is not a supported store: give one of {', '.join(SCHEMES)}")
        # Names without password are allowed: abfs has containers before @, and ssh users. HTTP
        # may have tokens there, and after ?. A password may contain slashes.
        web = scheme.lower() in ("http", "https")
        if re.match(r"(?s)[^/]*:.*@|.*[?#].*=" + (r"|[^/]*@|.*\?" if web else ""), rest):
            raise InputError(
                f"a URL of {scheme} contains possible credentials (before @, after ?): leave them "
                "out, and use the settings of the store, see docs/cluster.md")


def child(folder: Place, name: str) -> Place:
    """Return the place of a name within a folder."""
    return folder / name if isinstance(folder, Path) else f"{folder}/{name}"


def expand(places: Iterable[Place]) -> list[Place]:
    """Return places, with wildcards of URLs expanded, which a shell does not do.

    Raises `InputError` if a wildcard matches nothing, or its store cannot be read.
    """
    found: list[Place] = []
    for where in places:
        if isinstance(where, Path) or "*" not in where:
            found.append(where)
            continue
        with _opened(where) as (store, path):
            names = sorted(store.glob(path))
        if not names:
            raise InputError(f"nothing matches {where}")
        # Paths of some stores begin with a slash, those of others do not.
        before = where.removesuffix(path.lstrip("/"))
        found += [
            str(store.unstrip_protocol(name)) if before == where else before + name.lstrip("/")
            for name in names]
    return found


def recording_name(bag: Place) -> str:
    """Return the name of a recording: name of its folder, or of its file without suffix."""
    if isinstance(bag, Path):
        # Names of folders may contain dots.
        return bag.resolve().name if bag.is_dir() else bag.stem
    with _opened(bag) as (store, path):
        return PurePosixPath(bag).name if store.isdir(path) else PurePosixPath(bag).stem


@contextmanager
def recording_here(bag: Place) -> Iterator[Path]:
    """Yield the path of a recording; one at a URL is downloaded to a temporary folder."""
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
    """Yield the paths of several recordings, see `recording_here`; wildcards are expanded.

    Raises `InputError` if one cannot be downloaded.
    """
    with ExitStack() as fetched:
        yield [fetched.enter_context(recording_here(bag)) for bag in expand(bags)]


@contextmanager
def result_here(target: Place, *, force: bool = False) -> Iterator[Path]:
    """Yield the folder to make for a result; for a URL, upload it when it is complete.

    If something else appeared at the URL meanwhile, it is uploaded beside it (`InputError`).
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
    """Yield the folder of several results; for URLs, download files of each, upload new files."""
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
    """Yield a folder with some files of a result; for a URL, download them.

    Raises `InputError` if one is missing.
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
    """Return the names of all files at a place, if they may be replaced; the mark first."""
    names = [
        # The place may be a file.
        PurePosixPath(name).relative_to(path).as_posix() for name in store.find(path)]
    if not names:
        return []
    refuse_to_replace(target, MARK in names, several=DAY_MARK in names, force=force)
    RESULT.check_names(target, names, marked=True)
    return sorted(names, key=lambda name: name != MARK)


def _fetch(store: Any, path: str, here: Path) -> None:
    if not store.isdir(path):
        if store.exists(path):
            _fetch_files(store, {path: here})
        return
    files = {}
    # Recordings have no folders, and web pages may link to any number of them.
    for name in store.find(path, maxdepth=1):
        relative = PurePosixPath(name).relative_to(path)
        # Names of objects must not determine other folders on this machine.
        if ".." in relative.parts:
            raise InputError(f"the store has an object outside its folder: {name!r}")
        files[name] = here / relative
    if files:
        here.mkdir()
    _fetch_files(store, files)


def _fetch_files(store: Any, files: Mapping[str, Path]) -> None:
    """Download files, up to a limit of bytes."""
    folder = Path(tempfile.gettempdir())
    most = min(LARGEST, shutil.disk_usage(folder).free // 2)
    too_much = InputError(
        f"{next(iter(files), '')} and the files beside it have more than {most / 1e9:.3g} GB, half "
        f"of the free space in {folder} or the limit of downloads: set TMPDIR to a folder with "
        "more space, or download them yourself and give the folder")
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
    """Upload a result, its mark last, so that results with a mark are complete."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    for file in sorted(files, key=lambda file: file == folder / MARK):
        name = f"{path}/{file.relative_to(folder).as_posix()}"
        store.makedirs(name.rpartition("/")[0], exist_ok=True)
        store.put_file(str(file), name)


@contextmanager
def _opened(url: Place, work: str = "read") -> Iterator[tuple[Any, str]]:
    """Yield the store of a URL and the path in it; `work` is "read" or "write", for errors."""
    check_urls([url])
    with needing("stores", str(url)):
        fsspec = importlib.import_module("fsspec.core")
    with refusing(f"cannot use {url}", Exception):
        store, path = fsspec.url_to_fs(str(url))
    # Cached listings may be out of date.
    store.invalidate_cache()
    with refusing(f"cannot {work} {url}", Exception):
        yield store, str(path)
