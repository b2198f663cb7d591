# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A digest of all that the machine code of a kernel is made from."""

from __future__ import annotations

import functools
import hashlib
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba

_PACKAGE = __name__.partition(".")[0]
# Settings of numba that change code. The processor is in numba's own key.
_SETTINGS = (
    "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT",
    "DISABLE_INTEL_SVML", "LLVM_REFPRUNE_PASS", "LLVM_REFPRUNE_FLAGS",
)
_DIGITS = 16


def fingerprint(function: Callable[..., Any]) -> str:
    """Return a digest of a kernel's ingredients.

    These are the files of all functions that it reaches within the package, the values
    of the globals they use, the versions of numba and llvmlite, numba's settings, and the
    layout of the files that kernels are stored in.

    Parameters
    ----------
    function : function
        The kernel's Python function. What it calls must be defined by now.

    Returns
    -------
    str
        Hexadecimal digits.

    Raises
    ------
    TypeError
        If a global is of a kind that has no value to compare.
    """
    ingredients = {f"{function.__module__}.{function.__qualname__}", *_toolchain()}
    seen: set[int] = set()
    waiting: list[Any] = [function]
    while waiting:
        value = waiting.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, FunctionType) and _is_ours(value.__module__):
            file = value.__code__.co_filename
            ingredients.add(f"{value.__module__} {_digest_of_file(file)}")
            for name, used in _globals_of(value):
                used = _function_of(used)
                if isinstance(used, FunctionType):
                    waiting.append(used)
                else:
                    ingredients.add(f"{name} {_describe(name, used, function)}")
    return hashlib.sha256("\n".join(sorted(ingredients)).encode()).hexdigest()[:_DIGITS]


def note_source(function: Callable[..., Any]) -> None:
    """Take the digest of a function's file now, at its import.

    An upgrade may replace the file while the old code is in memory.
    """
    _digest_of_file(function.__code__.co_filename)


@functools.cache
def _digest_of_file(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def _toolchain() -> Iterator[str]:
    yield f"numba {numba.__version__}"
    yield f"llvmlite {llvmlite.__version__}"
    # How kernels are laid out in their files.
    yield f"storage {_digest_of_file(str(Path(__file__).with_name('storage.py')))}"
    for name in _SETTINGS:
        yield f"{name} {getattr(numba.config, name, None)!r}"


def _is_ours(module: str | None) -> bool:
    return module is not None and module.partition(".")[0] == _PACKAGE


def _globals_of(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield the globals and the enclosing function's variables that a function may use."""
    for name in sorted(_names_in(function.__code__)):
        if name in function.__globals__:
            yield f"{function.__module__}.{name}", function.__globals__[name]
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        yield f"{function.__module__}.{function.__qualname__}.{name}", cell.cell_contents


def _names_in(code: CodeType) -> set[str]:
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names |= _names_in(constant)
    return names


def _function_of(value: Any) -> Any:
    """Return the Python function behind a kernel or an intrinsic; other things as they are."""
    return getattr(value, "py_func", None) or getattr(value, "_defn", None) or value


def _describe(name: str, value: Any, kernel: Callable[..., Any]) -> str:
    if isinstance(value, ModuleType):
        ours = _is_ours(value.__name__) and value.__file__
        return f"{value.__name__} {_digest_of_file(value.__file__ or '') if ours else ''}"
    if isinstance(value, type | BuiltinFunctionType):
        return f"{value.__module__}.{value.__qualname__}"
    try:
        return hashlib.sha256(pickle.dumps(value, protocol=4)).hexdigest()
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise TypeError(
            f"{kernel.__qualname__} uses {name}, whose value cannot be compared: {error}"
        ) from error
