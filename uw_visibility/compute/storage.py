# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What a compiled kernel is on disk, and how machine code is made ready without a compiler.

Numba prepares for compilation before it loads a kernel: it imports and registers all
that Python code could be made of, imports the modules of all functions that were compiled
into the kernel, parses the kernel's bitcode, and asks it for each of its symbols. A
process that finds all kernels on disk needs none of it, and it was a third of a node's
start. Here the names of the symbols are stored beside the machine code, bitcode is
parsed once a kernel that is being compiled calls the stored one, and numba prepares
where machine code asks for a symbol that is not there.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

import llvmlite.binding as llvm
from numba.core import caching, codegen
from numba.core.compiler import CompileResult
from numba.core.environment import Environment, lookup_environment
from numba.core.runtime import rtsys


class StoredKernels(caching.CompileResultCacheImpl):  # type: ignore[misc]
    """Makes contents of a file of a compiled kernel, and a compiled kernel of those."""

    def reduce(self, result: CompileResult) -> Any:
        """Return what is stored of a kernel that was compiled."""
        module = result.library._get_module_for_linking()
        symbols = [*module.functions, *module.global_variables]
        *payload, environments = super().reduce(result)
        return (
            payload,
            [(e.globals["__name__"], e.consts, e.env_name) for e in environments],
            [symbol.name for symbol in symbols if not symbol.is_declaration],
            [symbol.name for symbol in symbols if symbol.is_declaration],
        )

    def rebuild(self, target_context: Any, stored: Any) -> CompileResult:
        """Return the kernel that was stored."""
        payload, described, defined, declared = stored
        _provide(declared, target_context)
        environments = tuple(_environment(*description) for description in described)
        restoring = _Restoring(target_context, defined)
        result = CompileResult._rebuild(restoring, *payload, environments)
        return result._replace(target_context=target_context)


class StoredKernelCache(caching.FunctionCache):  # type: ignore[misc]
    """Numba's cache of one function, without its preparation for compiling."""

    _impl_class = StoredKernels

    def load_overload(self, sig: Any, target_context: Any) -> CompileResult | None:
        """Return the machine code for types of arguments, or None where there is none."""
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


class StoredLibrary(codegen.JITCodeLibrary):  # type: ignore[misc]
    """Machine code from disk."""

    _bitcode: bytes
    _shared_module: Any

    @classmethod
    def restore(cls, generator: Any, stored: Any, defined: Iterable[str]) -> StoredLibrary:
        """Make machine code ready to be called, as ``_unserialize`` of the base class does."""
        name, _, (machine_code, bitcode) = stored
        library = cls(generator, name)
        library._bitcode = bitcode
        library.enable_object_caching()
        library._set_compiled_object(machine_code)
        library._finalize_final_module()
        generator._engine._defined_symbols.update(defined)
        return library

    def _get_module_for_linking(self) -> Any:
        """Return what is compiled into a kernel that calls this one."""
        if self._shared_module is None:
            self._shared_module = llvm.parse_bitcode(self._bitcode)
        return super()._get_module_for_linking()


class _Restoring:
    """A target context that makes libraries of what was stored."""

    def __init__(self, context: Any, defined: Iterable[str]) -> None:
        self._context = context
        self._defined = defined

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def codegen(self) -> _Restoring:
        return self

    def unserialize_library(self, stored: Any) -> StoredLibrary:
        return StoredLibrary.restore(self._context.codegen(), stored, self._defined)


def _environment(module: str, constants: list[Any], name: str) -> Environment:
    """Return what machine code of a function finds constants in.

    Its module need not be imported, as numba does: globals serve object mode alone.
    """
    environment = lookup_environment(name)
    if environment is None:
        loaded = sys.modules.get(module)
        environment = Environment({"__name__": module} if loaded is None else vars(loaded))
        environment.consts[:] = constants
        environment.env_name = name
        Environment._memo[name] = environment
    return environment


def _provide(names: Iterable[str], target_context: Any) -> None:
    """See to it that symbols are there: LLVM ends the process where one is not."""
    if all(map(_is_there, names)):
        return
    # Arrays, as nearly all kernels use them.
    rtsys.initialize(target_context)
    if not all(map(_is_there, names)):
        target_context.refresh()


def _is_there(name: str) -> bool:
    return name.startswith("llvm.") or llvm.address_of_symbol(name) is not None
