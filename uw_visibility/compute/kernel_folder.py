# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Folders of compiled kernels, and digests of the sources of kernels.

A kernel's file is code. It is loaded only from folders that nobody but the user or root can write
to; root trusts only root's folders.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import os
import re
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from uw_visibility.compute.numba_import import llvmlite, numba

# Number of other versions of a module's kernels that are kept, as of other checkouts or settings.
KEPT_VERSIONS = 2

log = logging.getLogger(__name__)
PACKAGE_FOLDER = Path(__file__).resolve().parents[1]
# Settings of numba that change code. The processor is in the key of each kernel.
_SETTINGS = (
    "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT",
    "DISABLE_INTEL_SVML", "LLVM_REFPRUNE_PASS", "LLVM_REFPRUNE_FLAGS",
)
_DIGITS = 16
# Imports within the package and its lab, also inside functions; none is relative.
_IMPORT = re.compile(
    rf"^[ \t]*(?:from +(?P<source>{PACKAGE_FOLDER.name}[\w.]*) +import +(?P<names>\([^)]*\)|.*)"
    rf"|import +(?P<module>{PACKAGE_FOLDER.name}[\w.]*))",
    re.MULTILINE,
)


def package_folder() -> Path:
    """Return the folder beside the sources, which an administrator may have filled."""
    return PACKAGE_FOLDER / "__pycache__" / "kernels"


@functools.cache
def writable_folder() -> Path | None:
    """Return the folder in which kernels are saved, or None if there is none.

    It is the first one that only the user can write to, of: ``uw_visibility`` in the user's
    ``NUMBA_CACHE_DIR``, the folder beside the sources, and ``uw_visibility`` in the user's folder
    for caches (``XDG_CACHE_HOME``, or else ``~/.cache``).
    """
    chosen = _chosen_folder()
    for folder in filter(None, (chosen, package_folder(), _user_folder())):
        try:
            folder.mkdir(mode=0o755, parents=True, exist_ok=True)
            if not _trusted(folder):
                continue
            # Permissions are not enough: the file system may be read-only.
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
    """Return the folders from which kernels are loaded: the writable one, then the package's."""
    writable, package = writable_folder(), package_folder()
    found = [] if writable is None else [writable]
    chosen = writable is not None and writable == _chosen_folder()
    if not chosen and writable != package and package.is_dir() and _trusted(package):
        found.append(package)
    return tuple(found)


def write(file: Path, content: bytes) -> None:
    """Write a file of a version's folder atomically; create the folder."""
    if not file.parent.exists():
        file.parent.mkdir(mode=0o755, exist_ok=True)
        _remove_old_versions(file.parent)
    descriptor, temporary = tempfile.mkstemp(dir=file.parent)
    try:
        with os.fdopen(descriptor, "wb") as opened:
            opened.write(content)
            os.fchmod(opened.fileno(), 0o644)
        Path(temporary).replace(file)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


@functools.cache
def warn_once(message: str) -> None:
    """Log a warning once, also if many kernels cause it."""
    log.warning(message)


def _trusted(folder: Path) -> bool:
    """Whether the user or root, and nobody else, can write to a folder."""
    status = folder.stat()
    if status.st_uid not in (0, os.geteuid()):
        reason = f"belongs to another user (number {status.st_uid})"
    elif status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        reason = "can be written to by others (chmod go-w ends that)"
    else:
        return True
    warn_once(f"compiled kernels in {folder} are not used: it {reason}")
    return False


def _remove_old_versions(folder: Path) -> None:
    """Delete old versions of a module's kernels, and kernels of modules that are gone."""
    module, _, version = folder.name.rpartition("-")
    others = [
        other for other in folder.parent.glob(f"{module}-{'[0-9a-f]' * len(version)}")
        if other != folder
    ]
    newest_first = sorted(others, key=_modified, reverse=True)
    old = newest_first[KEPT_VERSIONS:]
    if folder.parent == package_folder():
        # Other folders may be shared with checkouts that have other modules.
        old += [
            other for other in folder.parent.iterdir()
            if other.name.startswith(f"{PACKAGE_FOLDER.name}.")
            and source_of(other.name.rpartition("-")[0]) is None
        ]
    for other in old:
        # Only kernels and temporary files are removed, by their names.
        with suppress(OSError):
            for kernel in [*other.glob("*.kernel"), *other.glob("tmp????????")]:
                kernel.unlink(missing_ok=True)
            other.rmdir()


def _modified(folder: Path) -> float:
    """Return when a folder was written to, s, or 0 if another process has deleted it."""
    try:
        return folder.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def _chosen_folder() -> Path | None:
    # Read here, since a file in the current folder may change numba's value.
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
    # Relative paths are ignored, as the XDG Base Directory Specification says.
    if base.is_absolute():
        return base / "uw_visibility"
    try:
        home = Path.home()
    except RuntimeError:
        # The user has no entry, as in containers.
        return None
    return home / ".cache" / "uw_visibility" if home.is_absolute() else None


@functools.cache
def fingerprint(module: str) -> str:
    """Return a digest, hexadecimal digits, of all that the kernels of a module are compiled from.

    These are the sources of the module and of all modules of the package that it imports,
    directly or through others, since their functions and constants are compiled in; the
    package's tables; the versions of Python, numpy, numba and llvmlite; numba's settings. Call it
    when the module is imported, since an upgrade may replace files while old code is in memory.
    """
    files: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        file = source_of(name)
        if name not in files and file is not None:
            files[name] = file
            waiting += _imports(file)
    sources = [f"{name} {_digest(file)}" for name, file in sorted(files.items())]
    ingredients = "\n".join([*_environment(), *sources])
    return hashlib.sha256(ingredients.encode()).hexdigest()[:_DIGITS]


def source_of(module: str) -> Path | None:
    """Return the file of a module of the package or its lab, or None if there is none."""
    package, *names = module.split(".")
    loaded = sys.modules.get(package) if package.startswith(PACKAGE_FOLDER.name) else None
    if loaded is None or loaded.__file__ is None:
        return None
    return _module_file(loaded.__file__, tuple(names))


@functools.cache
def _module_file(package: str, names: tuple[str, ...]) -> Path | None:
    """Return the file of a module; cached, since the modules of kernels share many imports."""
    path = Path(package).resolve().parent.joinpath(*names)
    for file in (path.with_suffix(".py"), path / "__init__.py"):
        if file.is_file():
            return file
    return None


@functools.cache
def _imports(file: Path) -> list[str]:
    """Return the modules that a file may import, and names in them that may be modules."""
    found = []
    for match in _IMPORT.finditer(file.read_text(encoding="utf-8")):
        source = match["source"] or match["module"]
        names = re.findall(r"\w+", match["names"] or "")
        found += [source, *(f"{source}.{name}" for name in names)]
    return found


@functools.cache
def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _environment() -> Iterator[str]:
    yield f"python {sys.version}"
    for library in (np, numba, llvmlite):
        yield f"{library.__name__} {library.__version__}"
    for name in _SETTINGS:
        yield f"{name} {getattr(numba.config, name, None)!r}"
    # The format of kernel files.
    yield _digest(PACKAGE_FOLDER / "compute" / "jit.py")
    for table in sorted((PACKAGE_FOLDER / "data").glob("*.csv")):
        yield f"{table.name} {_digest(table)}"
