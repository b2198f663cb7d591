# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""An installation of a package of three modules with kernels, used by processes of its own."""

from __future__ import annotations

import ctypes
import functools
import inspect
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from prepared import Prepared

from uw_visibility.compute import kernel_folder

SOURCES = Path(kernel_folder.__file__).parents[1]
KERNELS = {
    "constants": "OFFSET = 100\n",
    "inner": """\
from uw_visibility.constants import OFFSET
from uw_visibility.compute.jit import njit

@njit(nogil=True)
def inner(x):
    return helper(x) + OFFSET

@njit(nogil=True)
def helper(x):
    return 2 * x
""",
    "outer": """\
from uw_visibility.inner import inner
from uw_visibility.compute.jit import njit

@njit(nogil=True)
def outer(x):
    return inner(x) + 1
""",
}
CALL = """\
import json
from uw_visibility.compute.jit import counts
from uw_visibility.compute.kernel_folder import writable_folder
from uw_visibility.outer import outer
print(json.dumps([outer(3), counts.loaded, counts.compiled, str(writable_folder())]))
"""
# capset(2) and capabilities(7).
CAPABILITY_VERSION, CAP_DAC_OVERRIDE = 0x20080522, 1


@dataclass
class Outcome:
    value: Any
    loaded: int
    compiled: int
    folder: Path
    said: str


class Install:
    """A folder with a package, as an installation has it, and processes that use it."""

    sources = KERNELS
    call = CALL

    def __init__(self, root: Path) -> None:
        self.root = root
        self.package = root / "lib" / "uw_visibility"
        self.home = root / "home"
        self.cache = self.home / ".cache" / "uw_visibility"
        self.kernels = self.package / "__pycache__" / "kernels"
        self.package.mkdir(parents=True)
        self.home.mkdir()
        self.write("__init__", "")
        shutil.copytree(
            SOURCES / "compute", self.package / "compute",
            ignore=shutil.ignore_patterns("__pycache__"),
        )
        for name, source in KERNELS.items():
            self.write(name, source)

    def write(self, name: str, source: str) -> None:
        (self.package / f"{name}.py").write_text(source)

    def replace(self, name: str, old: str, new: str) -> None:
        self.write(name, KERNELS[name].replace(old, new))

    def stored(self) -> list[Path]:
        """Return the files of kernels beside the package."""
        return sorted(path for path in self.kernels.rglob("*") if path.is_file())

    def protect(self, *folders: Path) -> None:
        """Let nobody write to folders."""
        for folder in folders:
            for path in [folder, *folder.rglob("*")]:
                path.chmod(0o555 if path.is_dir() else 0o444)

    def run(
        self, *, code: str = CALL, cwd: Path | None = None, fresh: bool = False,
        **environment: str,
    ) -> Outcome:
        """Call the outer kernel in a new process, which permissions bind.

        A fresh one imports numba itself.
        """
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "XDG"))}
        environment = {
            **kept, "PYTHONPATH": str(self.root / "lib"), "HOME": str(self.home),
            "PYTHONDONTWRITEBYTECODE": "1", **environment,
        }
        output, errors = self.root / "output", self.root / "errors"
        for file in (output, errors):
            file.write_text("")
        if fresh:
            with output.open("w") as said, errors.open("w") as warned:
                returncode = subprocess.run(
                    [sys.executable, "-P", "-c", BOUND + code], stdout=said, stderr=warned,
                    cwd=cwd or self.root, env=environment, check=False,
                ).returncode
        else:
            returncode = with_numba().start(
                BOUND + SET + code, environment=environment, cwd=cwd or self.root,
                output=output, errors=errors, path=[self.root / "lib"],
            ).wait(300)
        assert returncode == 0, errors.read_text()
        value, loaded, compiled, folder = json.loads(output.read_text())
        return Outcome(value, loaded, compiled, Path(folder), errors.read_text())


@functools.cache
def with_numba() -> Prepared:
    """A process that has imported numba, and has compiled something."""
    return Prepared("import numba\nnumba.njit(lambda x: x + 1)(3)\n", {
        k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "XDG", "PYTHONPATH"))})


def obey_permissions() -> None:
    """Take from root what lets it write where permissions say no."""
    header, sets = (ctypes.c_uint32 * 2)(CAPABILITY_VERSION, 0), (ctypes.c_uint32 * 6)()
    library = ctypes.CDLL(None)
    if library.capget(header, sets):
        raise OSError("the capabilities of the process are not known")
    # The effective and the permitted ones.
    sets[0], sets[1] = (each & ~(1 << CAP_DAC_OVERRIDE) for each in sets[:2])
    if library.capset(header, sets):
        raise OSError("a process cannot be bound by permissions")


BOUND = f"""\
import ctypes
CAPABILITY_VERSION, CAP_DAC_OVERRIDE = {CAPABILITY_VERSION}, {CAP_DAC_OVERRIDE}
{inspect.getsource(obey_permissions)}
obey_permissions()
"""
# Numba was imported with other environment variables.
SET = "import numba\nnumba.core.config.reload_config()\n"


@pytest.fixture
def install(tmp_path: Path) -> Iterator[Install]:
    yield Install(tmp_path)
    # Else what is protected stays behind.
    for path in tmp_path.rglob("*"):
        if path.is_dir():
            path.chmod(0o755)


@pytest.fixture(scope="session")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Kernels of an installation whose first call has been."""
    first = Install(tmp_path_factory.mktemp("compiled"))
    assert first.run().compiled == 3
    return first.kernels


@pytest.fixture
def make_install() -> type[Install]:
    """Make an installation in a folder."""
    return Install


@pytest.fixture
def warm(install: Install, compiled: Path) -> Install:
    """An installation that has these."""
    shutil.copytree(compiled, install.kernels)
    return install
