# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""An installation of a package of three modules with kernels, used by processes of its own."""

from __future__ import annotations

import ctypes
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
# prctl(2) and capabilities(7).
PR_CAPBSET_DROP, CAP_DAC_OVERRIDE = 24, 1


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

    def run(self, *, code: str = CALL, cwd: Path | None = None, **environment: str) -> Outcome:
        """Call the outer kernel in a new process, which permissions bind."""
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "XDG"))}
        process = subprocess.run(
            [sys.executable, "-P", "-c", code], capture_output=True, text=True, check=False,
            cwd=cwd or self.root, preexec_fn=obey_permissions, env={
                **kept, "PYTHONPATH": str(self.root / "lib"), "HOME": str(self.home),
                "PYTHONDONTWRITEBYTECODE": "1", **environment,
            },
        )
        assert process.returncode == 0, process.stderr
        value, loaded, compiled, folder = json.loads(process.stdout)
        return Outcome(value, loaded, compiled, Path(folder), process.stderr)


def obey_permissions() -> None:
    """Take from root what lets it write where permissions say no; called in the child."""
    if os.getuid() == 0 and ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, 0, 0, 0):
        raise OSError("root without CAP_SETPCAP cannot be bound by permissions")


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
