# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels on disk, in processes of their own with a package of three modules."""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import pkgutil
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher

import uw_visibility
from uw_visibility.compute import fingerprint as kernel_fingerprint
from uw_visibility.compute import jit as kernel_cache

SOURCES = Path(kernel_cache.__file__).parents[1]
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
from uw_visibility.compute.jit import counts, writable_folder
from uw_visibility.outer import outer
print(json.dumps([outer(3), counts.loaded, counts.compiled, str(writable_folder())]))
"""
# prctl(2) and capabilities(7).
PR_CAPBSET_DROP, CAP_DAC_OVERRIDE = 24, 1


@dataclass
class Outcome:
    value: int
    loaded: int
    compiled: int
    folder: Path
    said: str


class Install:
    """A folder with a package, as an installation has it, and processes that use it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.package = root / "lib" / "uw_visibility"
        self.home = root / "home"
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

    def protect(self, *folders: Path) -> None:
        """Let nobody write to folders."""
        for folder in folders:
            for path in [folder, *folder.rglob("*")]:
                path.chmod(0o555 if path.is_dir() else 0o444)

    def run(self, *, code: str = CALL, **environment: str) -> Outcome:
        """Call the outer kernel in a new process, which permissions bind."""
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "XDG"))}
        process = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=False,
            cwd=self.root, preexec_fn=obey_permissions, env={
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


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Kernels of an installation whose first call has been."""
    first = Install(tmp_path_factory.mktemp("compiled"))
    assert first.run().compiled == 3
    return first.kernels


@pytest.fixture
def warm(install: Install, compiled: Path) -> Install:
    """An installation that has these."""
    shutil.copytree(compiled, install.kernels)
    return install


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.nb[ic]"))


def test_a_kernel_is_compiled_once_and_anew_after_any_change(install: Install) -> None:
    first = install.run()
    assert (first.value, first.loaded, first.compiled) == (107, 0, 3)
    assert first.folder == install.kernels
    again = install.run()
    assert (again.value, again.loaded, again.compiled) == (107, 1, 0)

    # The outer kernel's file stays the same in all that follows.
    install.replace("inner", "2 * x", "5 * x")
    assert install.run().value == 116
    install.write("constants", "OFFSET = 500\n")
    assert install.run().value == 516
    assert install.run(NUMBA_OPT="1").compiled == 3

    # Back at what was there before, it is still known, ...
    install.write("inner", KERNELS["inner"])
    install.write("constants", KERNELS["constants"])
    assert install.run().value == 107
    # ... and what is kept of other versions has an end.
    install.write("constants", "OFFSET = 7\n")
    assert install.run().value == 14
    indices = [path.name for path in files(install.kernels) if path.suffix == ".nbi"]
    assert sum(name.startswith("outer.") for name in indices) == 1 + kernel_cache.KEPT_VERSIONS
    machine_code = [path for path in files(install.kernels) if path.suffix == ".nbc"]
    assert len(machine_code) == len(indices)


def test_what_is_on_disk_is_compiled_into_what_calls_it(warm: Install) -> None:
    warm.replace("outer", "+ 1", "+ 2")
    outcome = warm.run()
    assert (outcome.value, outcome.loaded, outcome.compiled) == (108, 1, 1)


def test_kernels_from_disk_have_the_symbols_that_they_need(install: Install) -> None:
    """LLVM ends the process where one is missing: those of hashing numba adds late."""
    install.write("inner", """\
from uw_visibility.compute.jit import njit

@njit(nogil=True)
def inner(x):
    name = "three" if x == 3 else "many"
    if x > 3:
        raise ValueError("too many", x)
    return x if hash(name) != 0 else 0
""")
    complain = CALL + (
        "try:\n    outer(5)\n"
        "except ValueError as error:\n    assert error.args == ('too many', 5)\n"
        "else:\n    raise AssertionError\n"
    )
    assert install.run(code=complain).value == 4
    again = install.run(code=complain)
    assert (again.value, again.loaded, again.compiled) == (4, 1, 0)


def test_a_change_while_a_process_runs_is_not_taken_for_its_code(install: Install) -> None:
    """An upgrade under a running node: what it compiles from then on is of the old code."""
    upgrade = (
        "import uw_visibility.outer, pathlib\n"
        "file = pathlib.Path(uw_visibility.outer.__file__)\n"
        "file.write_text(file.read_text().replace('+ 1', '+ 2'))\n"
    )
    assert install.run(code=upgrade + CALL).value == 107
    assert install.run().value == 108


def test_read_only_install_uses_the_users_folder(install: Install) -> None:
    install.protect(install.package)
    cache = install.root / "cache"
    cache.mkdir()
    first = install.run(XDG_CACHE_HOME=str(cache))
    assert (first.value, first.compiled, first.folder) == (107, 3, cache / "uw_visibility")
    again = install.run(XDG_CACHE_HOME=str(cache))
    assert (again.loaded, again.compiled, again.said) == (1, 0, "")
    assert not install.kernels.exists()


def test_what_came_with_a_read_only_install_is_used(warm: Install) -> None:
    """An administrator warms up the installation; a user without home starts the node."""
    warm.protect(warm.package, warm.home)
    outcome = warm.run()
    assert (outcome.value, outcome.loaded, outcome.compiled) == (107, 1, 0)


def test_without_any_folder_kernels_work_and_the_reason_is_said_once(install: Install) -> None:
    install.protect(install.package, install.home)
    outcome = install.run()
    assert (outcome.value, outcome.compiled, str(outcome.folder)) == (107, 3, "None")
    assert outcome.said.count("NUMBA_CACHE_DIR") == 1


def test_the_users_choice_wins(warm: Install) -> None:
    chosen = warm.root / "chosen"
    outcome = warm.run(NUMBA_CACHE_DIR=str(chosen))
    assert (outcome.folder, outcome.compiled) == (chosen / "uw_visibility", 3)
    assert warm.run(NUMBA_CACHE_DIR=str(chosen)).compiled == 0
    # A choice that cannot be used is said, and the next place taken.
    (warm.root / "file").write_text("")
    outcome = warm.run(NUMBA_CACHE_DIR=str(warm.root / "file"))
    assert outcome.folder == warm.kernels
    assert "NUMBA_CACHE_DIR" in outcome.said


def test_damaged_files_are_compiled_anew(warm: Install) -> None:
    for content in (b"", b"\x80\x05garbage"):
        for path in files(warm.kernels):
            path.write_bytes(content)
        outcome = warm.run()
        assert (outcome.value, outcome.compiled) == (107, 3), content
        assert "is damaged" in outcome.said, content
    healed = warm.run()
    assert (healed.loaded, healed.compiled, healed.said) == (1, 0, "")


def test_a_full_disk_costs_the_cache_alone(install: Install) -> None:
    full = (
        "import numba.core.caching as caching\n"
        "def fail(*_): raise OSError(28, 'No space left on device')\n"
        "caching.IndexDataCacheFile.save = fail\n"
    )
    outcome = install.run(code=full + CALL)
    assert outcome.value == 107
    assert outcome.said.count("No space left on device") == 1


def test_other_packages_keep_numbas_own_cache(install: Install) -> None:
    (install.root / "lib" / "other.py").write_text(
        "import numba\n@numba.njit(cache=True)\ndef double(x):\n    return 2 * x\n"
    )
    use = "import other\nassert other.double(4) == 8\n"
    install.run(code=CALL + use)
    assert len(files(install.root / "lib" / "__pycache__")) == 2


def kernels() -> dict[str, Any]:
    """Return every kernel of the package, by its full name."""
    found = {}
    for info in pkgutil.walk_packages(uw_visibility.__path__, "uw_visibility."):
        if info.name.startswith(("uw_visibility.ros", "uw_visibility.replay")):
            continue
        module = importlib.import_module(info.name)
        for value in vars(module).values():
            if isinstance(value, Dispatcher):
                function = value.py_func
                found[f"{function.__module__}.{function.__qualname__}"] = value
    return found


def test_every_kernel_has_this_cache_and_a_fingerprint_of_its_own() -> None:
    found = kernels()
    assert len(found) > 80
    for name, kernel in found.items():
        assert isinstance(kernel._cache, kernel_cache.KernelCache), name
    prints = {kernel_fingerprint.fingerprint(kernel.py_func) for kernel in found.values()}
    assert len(prints) == len(found)


@pytest.mark.parametrize(
    ("changed", "kernel"),
    [
        # An intrinsic's code, which is run at compilation only, and two calls away.
        ("stereo/elas/absolute_difference.py", "uw_visibility.stereo.elas.dense._try_candidates"),
        ("water/envelope_loss.py", "uw_visibility.water.lower_envelope._minimise"),
    ],
)
def test_the_packages_kernels_know_what_they_are_made_from(
    changed: str, kernel: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    function = kernels()[kernel].py_func
    before = kernel_fingerprint.fingerprint(function)
    digest = kernel_fingerprint._digest_of_file
    monkeypatch.setattr(
        kernel_fingerprint, "_digest_of_file",
        lambda path: "changed" if path.endswith(changed) else digest(path),
    )
    assert kernel_fingerprint.fingerprint(function) != before


def test_kernel_that_cannot_be_kept_runs_with_a_warning(install: Install) -> None:
    # Large arrays are not compiled in, but pointed to; without optimisation, others too.
    install.write("inner", KERNELS["inner"].replace("return 2 * x", "return TWOS[0] * x").replace(
        "@njit", "import numpy as np\nTWOS = np.full(1_000_000, 2)\n\n@njit", 1
    ))
    done = install.run()
    assert done.value == 107
    assert 'Cannot cache compiled function "helper"' in done.said
