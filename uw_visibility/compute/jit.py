# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels compiled by numba, with a cache on disk.

Numba's own cache takes a kernel for current while its own source file is unchanged, although
functions and constants of other modules are compiled into it. It fails on a damaged file and on
a full disk, crashes on damaged machine code, and runs files that anybody may have written. Here
the folder of a kernel's file is named by a digest of all its sources (`fingerprint`); the file
begins with a digest of its content, and is loaded only from folders that no other user can
write to (`kernel_folder`).

Numba's configuration and other packages' caches are unchanged: modules of this
package import `njit` from here.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uw_visibility.compute import kernel_folder
from uw_visibility.compute.kernel_folder import fingerprint, log, warn_once
from uw_visibility.compute.numba_import import caching, dumps, numba

_DIGEST_SIZE = hashlib.sha256().digest_size


@dataclass
class KernelCounts:
    """Numbers of kernels that this process has loaded from disk, and compiled."""

    loaded: int = 0
    compiled: int = 0


counts = KernelCounts()


def njit(*, cache: bool = True, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function as `numba.njit` does, with this cache in place of numba's.

    Not for closures, since the digest does not cover their variables. `cache` is whether to keep
    the machine code on disk.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        # No kernel is called from C, so it needs no wrapper for that.
        kernel = numba.njit(no_cfunc_wrapper=True, **options)(function)
        # With NUMBA_DISABLE_JIT numba returns the function itself.
        if cache and kernel is not function:
            if function.__closure__:
                raise TypeError(f"{function.__qualname__} uses variables of another function")
            # Private: numba's interface offers its own cache (cache=True) or none.
            kernel._cache = KernelCache(function)
        return kernel

    return decorate


class _Serializer(caching.CompileResultCacheImpl):  # type: ignore[misc]
    """Numba's serialisation of a compiled kernel, without its search for a folder."""

    def __init__(self) -> None:
        """Skip the base class's search for a folder."""


class KernelCache:
    """Cache of one kernel, with the interface that numba's dispatcher calls."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._folder = f"{function.__module__}-{fingerprint(function.__module__)}"
        self._serializer = _Serializer()

    @property
    def cache_path(self) -> str | None:
        """Folder that the kernel is saved to, or None."""
        folder = kernel_folder.writable_folder()
        return None if folder is None else str(folder / self._folder)

    def flush(self) -> None:
        """Do nothing: a new kernel overwrites the saved one."""

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Load the machine code for types of arguments; None if it is not on disk."""
        identity = self._identity(signature, target_context)
        for folder in kernel_folder.folders():
            file = self._file(folder, identity)
            try:
                content = file.read_bytes()
                payload = content[_DIGEST_SIZE:]
                if content != _sealed(identity, payload):
                    raise ValueError("its content is not what was written")
                # Makes the parts of numba's library available that machine code refers to.
                target_context.refresh()
                kernel = self._serializer.rebuild(target_context, pickle.loads(payload))
            except (FileNotFoundError, PermissionError):
                continue
            except Exception as error:
                # After any error the kernel can be compiled.
                log.warning("compiling %s anew: %s is damaged (%s)", self._name, file, error)
                continue
            counts.loaded += 1
            return kernel
        return None

    def save_overload(self, signature: Any, kernel: Any) -> None:
        """Save a compiled kernel; one that cannot be saved still works."""
        counts.compiled += 1
        folder = kernel_folder.writable_folder()
        if folder is None:
            return
        if kernel.library.has_dynamic_globals:
            log.warning(
                "%s is compiled at every start: it uses addresses, such as that of a large array "
                "that is not an argument", self._name,
            )
            return
        identity = self._identity(signature, kernel.target_context)
        payload = dumps(self._serializer.reduce(kernel))
        try:
            kernel_folder.write(self._file(folder, identity), _sealed(identity, payload))
        except OSError as error:
            warn_once(f"cannot keep compiled kernels in {folder}: {error.strerror}")

    def _identity(self, signature: Any, target_context: Any) -> str:
        """Return what distinguishes this machine code from others of the same sources."""
        processor = target_context.codegen().magic_tuple()
        return f"{self._folder} {self._name} {signature} {processor}"

    def _file(self, folder: Path, identity: str) -> Path:
        key = hashlib.sha256(identity.encode()).hexdigest()[:16]
        return folder / self._folder / f"{self._name.rpartition('.')[2]}-{key}.kernel"


def _sealed(identity: str, payload: bytes) -> bytes:
    return hashlib.sha256(identity.encode() + payload).digest() + payload
