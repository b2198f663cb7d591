# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings and results in object stores, by fsspec: fetched, worked on here, and stored."""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, TypeAlias

from uw_visibility.errors import InputError, needing, refusing
from uw_visibility.replay.results.folder import MARK, check_target, read_state, refuse_to_replace

Place: TypeAlias = Path | str
"""Where a recording or a result is: a path of this machine, or a URL."""

PREFIX = "uw_visibility-"


def place(text: str) -> Place:
    """Return the place that a text names: a URL such as ``s3://bucket/dive``, or a path."""
    return text.rstrip("/") if "://" in text else Path(text)


def child(folder: Place, name: str) -> Place:
    """Return the place of a name within a folder."""
    return folder / name if isinstance(folder, Path) else f"{folder}/{name}"


def absolute(where: Place) -> Place:
    """Return a place that other processes understand alike."""
    return where.resolve() if isinstance(where, Path) else where


def expand(where: Place) -> list[Place]:
    """Return the places that a URL with wildcards names, which no shell expands; else itself.

    Raises
    ------
    InputError
        If there are none, or the store cannot be read.
    """
    if isinstance(where, Path) or "*" not in where:
        return [where]
    with _opened(where) as (store, path):
        found = [str(store.unstrip_protocol(name)) for name in sorted(store.glob(path))]
    if not found:
        raise InputError(f"nothing is at {where}")
    return list(found)


def recording_name(bag: Place) -> str:
    """Return the name of a recording: that of its folder, or of its file without the format."""
    if isinstance(bag, Path):
        # A folder's name may have dots in it, a file's ends with its format.
        return bag.resolve().name if bag.is_dir() else bag.stem
    with _opened(bag) as (store, path):
        return PurePosixPath(bag).name if store.isdir(path) else PurePosixPath(bag).stem


@contextmanager
def recording_here(bag: Place) -> Iterator[Path]:
    """Fetch a recording to a folder of this machine, for as long as it is needed.

    Parameters
    ----------
    bag : Path or str
        A path is yielded as it is.

    Raises
    ------
    InputError
        If it cannot be fetched.
    """
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

    Raises
    ------
    InputError
        If one cannot be fetched.
    """
    with ExitStack() as fetched:
        yield [
            fetched.enter_context(recording_here(bag)) for each in bags for bag in expand(each)]


@contextmanager
def result_here(target: Place) -> Iterator[Path]:
    """Make room on this machine for a result, and store it when it is complete.

    Parameters
    ----------
    target : Path or str
        A path is yielded as it is.

    Yields
    ------
    Path
        Folder to make.

    Raises
    ------
    InputError
        If it cannot be stored.
    """
    if isinstance(target, Path):
        yield target
        return
    with tempfile.TemporaryDirectory(prefix=PREFIX) as scratch:
        folder = Path(scratch) / PurePosixPath(target).name
        yield folder
        with _opened(target, "write") as (store, path):
            if store.exists(path):
                store.rm(path, recursive=True)
            _put(store, path, folder)


@contextmanager
def results_here(output: Place, results: Sequence[Place], names: Sequence[str]) -> Iterator[Path]:
    """Fetch some files of several results, and store what is written beside their folders.

    Parameters
    ----------
    output : Path or str
        Folder of all results; a path is yielded as it is.
    results : sequence of Path or str
        Those that are there.
    names : sequence of str
        Files to fetch of each.

    Yields
    ------
    Path
        Folder with a folder of each result.

    Raises
    ------
    InputError
        If something cannot be fetched or stored.
    """
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
                for name in names:
                    store.get_file(f"{path}/{name}", str(here / name))
        yield folder
        with _opened(output, "write") as (store, path):
            for written in sorted(folder.iterdir()):
                if written.is_file():
                    store.put_file(str(written), f"{path}/{written.name}")


def read_state_at(target: Place) -> dict[str, Any]:
    """Read the state of a result, as `read_state` does.

    Raises
    ------
    InputError
        If there is none.
    """
    if isinstance(target, Path):
        return read_state(target)
    with tempfile.TemporaryDirectory(prefix=PREFIX) as scratch:
        with _opened(target) as (store, path):
            store.get_file(f"{path}/{MARK}", f"{scratch}/{MARK}")
        return read_state(Path(scratch))


def check_place(target: Place, force: bool) -> None:
    """Refuse a place that must not be overwritten, as `check_target` does.

    Raises
    ------
    InputError
        If there is another result, or something else.
    """
    if isinstance(target, Path):
        check_target(target, force)
        return
    with _opened(target) as (store, path):
        there, result = store.exists(path), store.exists(f"{path}/{MARK}")
    if there:
        refuse_to_replace(target, result, force)


def exists(where: Place) -> bool:
    """Return whether something is at a place.

    Raises
    ------
    InputError
        If its store cannot be read.
    """
    if isinstance(where, Path):
        return where.exists()
    with _opened(where) as (store, path):
        return bool(store.exists(path))


def _fetch(store: Any, path: str, here: Path) -> None:
    if not store.isdir(path):
        if store.exists(path):
            store.get_file(path, str(here))
        return
    for name in store.find(path):
        relative = PurePosixPath(name).relative_to(path)
        # Whoever names the objects must not choose where on this machine they go.
        if ".." in relative.parts:
            raise InputError(f"the store has an object outside of its folder: {name!r}")
        file = here / relative
        file.parent.mkdir(parents=True, exist_ok=True)
        store.get_file(name, str(file))


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
    with needing("stores", str(url)):
        fsspec = importlib.import_module("fsspec.core")
    with refusing(f"cannot use {url}", Exception):
        store, path = fsspec.url_to_fs(str(url))
    # What was listed before may have changed since.
    store.invalidate_cache()
    with refusing(f"cannot {work} {url}", Exception):
        yield store, str(path)
