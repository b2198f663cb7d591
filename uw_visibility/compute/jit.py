# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels on disk: where they are kept, and when what is kept may be used.

Numba's own cache holds a kernel for fresh as long as its own file is unchanged, though
functions and constants of other modules are compiled into it; it refuses to import a
package whose folder and home cannot be written to, ignores what an administrator has
compiled into a folder that the user may only read, and fails on a damaged file and on
a full disk. Here a kernel's files carry a fingerprint of all that it was made from, in
their names, so that those of another version can never be taken for it.

Nothing of numba's configuration is changed, and no other package's cache: modules of
this package take their `njit` from here.
"""

from __future__ import annotations

import functools
import logging
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
from numba.core import caching

from uw_visibility.compute.fingerprint import fingerprint, note_source
from uw_visibility.compute.storage import StoredKernelCache, StoredKernels

PACKAGE_FOLDER = Path(__file__).resolve().parents[1]
# Other versions of a kernel that stay on disk: another checkout's or another setting's.
KEPT_VERSIONS = 2

log = logging.getLogger(__name__)


@dataclass
class KernelCounts:
    """Kernels of this process so far: one for each kernel and types of arguments.

    Attributes
    ----------
    loaded : int
        Found on disk.
    compiled : int
        Compiled, since they were not.
    """

    loaded: int = 0
    compiled: int = 0


counts = KernelCounts()


def njit(*, cache: bool = True, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function as `numba.njit` does, with this cache in place of numba's.

    Parameters
    ----------
    cache : bool
        Whether to keep the machine code on disk.
    **options
        As for `numba.njit`.

    Returns
    -------
    callable
        The decorator.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        kernel = numba.njit(**options)(function)
        # With NUMBA_DISABLE_JIT the function comes back as it is.
        if cache and kernel is not function:
            note_source(function)
            kernel._cache = KernelCache(function)
        return kernel

    return decorate


class KernelCache(caching._Cache):  # type: ignore[misc]
    """The files of one kernel, in the form that numba's dispatcher asks for.

    Parameters
    ----------
    function : function
        The kernel's Python function.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._enabled = True

    @property
    def cache_path(self) -> str | None:
        """Folder that the kernel is saved to, or None."""
        folder = writable_folder()
        return None if folder is None else str(folder / self._function.__module__)

    def enable(self) -> None:
        """Load and save from now on."""
        self._enabled = True

    def disable(self) -> None:
        """Neither load nor save from now on."""
        self._enabled = False

    def flush(self) -> None:
        """Forget what was saved."""
        if self._saving is not None:
            self._saving.flush()

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return the machine code for types of arguments, or None where there is none."""
        if not self._enabled:
            return None
        for files in self._loading:
            found = self._load(files, signature, target_context)
            if found is not None:
                counts.loaded += 1
                return found
        return None

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep what was compiled; a kernel that cannot be kept works as well."""
        counts.compiled += 1
        if not self._enabled or self._saving is None:
            return
        try:
            self._saving.save_overload(signature, data)
            self._remove_old_versions(Path(self._saving.cache_path))
        except OSError as error:
            _warn_once(f"cannot keep compiled kernels in {writable_folder()}: {error.strerror}")

    def _load(self, files: Any, signature: Any, target_context: Any) -> Any:
        try:
            return files.load_overload(signature, target_context)
        except Exception as error:
            # What a loss of power left of a file; any exception may come of it.
            log.warning(
                "compiling %s anew: its file in %s is damaged (%s)",
                self._function.__qualname__, files.cache_path, type(error).__name__,
            )
        if files is self._saving:
            try:
                files.flush()
            except OSError as error:
                _warn_once(f"cannot write to {files.cache_path}: {error.strerror}")
        return None

    @functools.cached_property
    def _saving(self) -> Any:
        folder = writable_folder()
        return None if folder is None else self._files(folder)

    @functools.cached_property
    def _loading(self) -> list[Any]:
        """Where to look: the folder that is written to, then what came with the package."""
        places = [] if self._saving is None else [self._saving]
        chosen = writable_folder() is not None and writable_folder() == _chosen_folder()
        if not chosen and writable_folder() != package_folder():
            places.append(self._files(package_folder()))
        return places

    def _files(self, folder: Path) -> Any:
        """Numba's reading and writing of files, in a folder and under names of ours."""
        version = self._fingerprint
        path = folder / self._function.__module__

        class Locator(caching._CacheLocator):  # type: ignore[misc]
            @classmethod
            def from_function(cls, function: Any, file: str) -> Locator:
                locator = cls()
                # Named in numba's warning of a kernel that cannot be kept.
                locator._py_file = file
                return locator

            def get_cache_path(self) -> str:
                return str(path)

            def get_source_stamp(self) -> str:
                return version

            def get_disambiguator(self) -> str:
                return version

        class Files(StoredKernels):
            _locator_classes: list[type] = [Locator]  # noqa: RUF012

        class Cache(StoredKernelCache):
            _impl_class = Files

        return Cache(self._function)

    @functools.cached_property
    def _fingerprint(self) -> str:
        # Not before the first call: what a kernel refers to may stand below it.
        return fingerprint(self._function)

    def _remove_old_versions(self, folder: Path) -> None:
        """Delete all but the newest other versions of this kernel for this Python."""
        stem = f"{Path(self._function.__code__.co_filename).stem}.{self._function.__qualname__}-"
        ending = f".py{sys.version_info[0]}{sys.version_info[1]}{sys.abiflags}.nbi"
        indices = [
            file for file in folder.glob(f"{stem}*{ending}")
            if self._fingerprint not in file.name
        ]
        newest_first = sorted(indices, key=lambda file: file.stat().st_mtime, reverse=True)
        for index in newest_first[KEPT_VERSIONS:]:
            for file in folder.glob(f"{index.stem}.*"):
                file.unlink(missing_ok=True)


def package_folder() -> Path:
    """Return the folder beside the sources, which an administrator may have filled."""
    return PACKAGE_FOLDER / "__pycache__" / "kernels"


@functools.cache
def writable_folder() -> Path | None:
    """Return the folder that kernels are kept in, or None where none can be written to.

    It is the first of ``uw_visibility`` in the user's ``NUMBA_CACHE_DIR``, the folder
    beside the sources, and ``uw_visibility`` in the user's folder for caches
    (``XDG_CACHE_HOME``, or else ``~/.cache``).
    """
    chosen = _chosen_folder()
    for folder in _candidates():
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # Permissions do not tell: root ignores them, and file systems can be read-only.
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError as error:
            if folder == chosen:
                _warn_once(f"cannot write to NUMBA_CACHE_DIR {chosen.parent}: {error.strerror}")
    _warn_once(
        "compiled kernels cannot be kept, so that every start takes as long as the first: "
        f"neither {package_folder()} nor {_user_folder() or 'a home folder'} can be written to; "
        "name a folder that can in NUMBA_CACHE_DIR"
    )
    return None


def _candidates() -> Iterator[Path]:
    for folder in (_chosen_folder(), package_folder(), _user_folder()):
        if folder is not None:
            yield folder


def _chosen_folder() -> Path | None:
    chosen = numba.config.CACHE_DIR
    return Path(chosen) / "uw_visibility" if chosen else None


def _user_folder() -> Path | None:
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    # Relative ones are to be ignored: XDG Base Directory Specification.
    if base.is_absolute():
        return base / "uw_visibility"
    try:
        return Path.home() / ".cache" / "uw_visibility"
    except RuntimeError:
        # A user without an entry, as in containers.
        return None


@functools.cache
def _warn_once(message: str) -> None:
    log.warning(message)


__all__ = ["KernelCache", "KernelCounts", "counts", "njit", "package_folder", "writable_folder"]
