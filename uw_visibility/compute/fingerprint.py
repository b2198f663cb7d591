# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Digest of all that the machine code of a module's kernels is made from."""

from __future__ import annotations

import functools
import hashlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from uw_visibility.compute.numba_import import llvmlite, numba

PACKAGE_FOLDER = Path(__file__).resolve().parents[1]
# Settings of numba that change code. The processor is in the key of each kernel.
_SETTINGS = (
    "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT",
    "DISABLE_INTEL_SVML", "LLVM_REFPRUNE_PASS", "LLVM_REFPRUNE_FLAGS",
)
_DIGITS = 16
# Imports within the package, those inside of functions too; none is relative.
_IMPORT = re.compile(
    rf"^[ \t]*(?:from +(?P<source>{PACKAGE_FOLDER.name}[\w.]*) +import +(?P<names>\([^)]*\)|.*)"
    rf"|import +(?P<module>{PACKAGE_FOLDER.name}[\w.]*))",
    re.MULTILINE,
)


@functools.cache
def fingerprint(module: str) -> str:
    """Return a digest of what the kernels of a module are compiled from.

    These are the sources of the module and of all modules of the package that it imports,
    directly or through others, since their functions and constants are compiled in; the
    package's tables; the versions of Python, numpy, numba and llvmlite; numba's settings.

    Parameters
    ----------
    module : str
        Full name. It is to be asked for when it is imported, since an upgrade may replace
        files while the old code is in memory.

    Returns
    -------
    str
        Hexadecimal digits.

    Raises
    ------
    OSError
        If a source cannot be read.
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
    ingredients = "\n".join([*_surroundings(), *sources])
    return hashlib.sha256(ingredients.encode()).hexdigest()[:_DIGITS]


def source_of(module: str) -> Path | None:
    """Return the file of a module of the package, or None where there is none."""
    package, *names = module.split(".")
    if package != PACKAGE_FOLDER.name:
        return None
    path = PACKAGE_FOLDER.joinpath(*names)
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


def _surroundings() -> Iterator[str]:
    yield f"python {sys.version}"
    for library in (np, numba, llvmlite):
        yield f"{library.__name__} {library.__version__}"
    for name in _SETTINGS:
        yield f"{name} {getattr(numba.config, name, None)!r}"
    # How a kernel's file is laid out.
    yield _digest(PACKAGE_FOLDER / "compute" / "jit.py")
    for table in sorted((PACKAGE_FOLDER / "data").glob("*.csv")):
        yield f"{table.name} {_digest(table)}"
