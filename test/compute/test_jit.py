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
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher

import uw_visibility
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
pytestmark = pytest.mark.node

# prctl(2) and capabilities(7).
PR_CAPBSET_DROP, CAP_DAC_OVERRIDE = 24, 1
NOBODY = 65534
as_root = pytest.mark.skipif(os.getuid() != 0, reason="only root can give files to others")


@dataclass
class Outcome:
    value: Any
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
    return sorted(path for path in folder.rglob("*") if path.is_file())


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

    # Back at what was there before, it is compiled anew, ...
    install.write("inner", KERNELS["inner"])
    install.write("constants", KERNELS["constants"])
    assert install.run().value == 107
    # ... since what is kept of other versions has an end.
    versions = [path.name for path in install.kernels.iterdir()]
    for module in ("inner", "outer"):
        kept = [name for name in versions if name.startswith(f"uw_visibility.{module}-")]
        assert len(kept) == 1 + kernel_folder.KEPT_VERSIONS


def test_kernels_of_modules_that_are_gone_are_deleted_beside_the_package(warm: Install) -> None:
    kept = sorted(path.name for path in warm.kernels.iterdir())
    for name in ("uw_visibility.gone-0123456789abcdef", "uw_visibility.outer"):
        (warm.kernels / name).mkdir()
    assert warm.run().loaded == 1
    warm.replace("outer", "+ 1", "+ 2")
    warm.run()
    names = sorted(path.name for path in warm.kernels.iterdir())
    assert set(kept) < set(names) and len(names) == len(kept) + 1
    # Another folder may serve several checkouts.
    elsewhere = warm.cache / "uw_visibility.gone-0123456789abcdef"
    elsewhere.mkdir(parents=True, mode=0o700)
    warm.protect(warm.package)
    warm.run(NUMBA_OPT="1")
    assert elsewhere.is_dir() and len(list(warm.cache.iterdir())) > 1


def test_a_constant_of_another_module_is_known_however_it_is_imported(install: Install) -> None:
    imports = [
        "from uw_visibility import constants",
        "from uw_visibility import (\n    errors,\n    constants,\n)",
        "import uw_visibility.constants as constants",
        "if True:\n    from uw_visibility import constants",
        "",
    ]
    for number, line in enumerate(imports):
        install.write(f"importer_{number}", line)
    names = [f"uw_visibility.importer_{number}" for number in range(len(imports))]
    code = (
        "import json\nfrom uw_visibility.compute.fingerprint import fingerprint\n"
        f"print(json.dumps([[fingerprint(name) for name in {names}], 0, 0, '']))\n"
    )
    before = install.run(code=code).value
    install.write("constants", "OFFSET = 200\n")
    after = install.run(code=code).value
    assert [old != new for old, new in zip(before, after, strict=True)] == [True] * 4 + [False]


def test_what_is_on_disk_is_compiled_into_what_calls_it(warm: Install) -> None:
    warm.replace("outer", "+ 1", "+ 2")
    outcome = warm.run()
    assert (outcome.value, outcome.loaded, outcome.compiled) == (108, 1, 1)


def test_a_change_while_a_process_runs_is_not_taken_for_its_code(install: Install) -> None:
    """An upgrade under a running node: what it compiles from then on is of the old code."""
    upgrade = (
        "import uw_visibility.outer, pathlib\n"
        "file = pathlib.Path(uw_visibility.outer.__file__)\n"
        "file.write_text(file.read_text().replace('+ 1', '+ 2'))\n"
    )
    assert install.run(code=upgrade + CALL).value == 107
    assert install.run().value == 108


def test_a_kernel_within_a_function_is_refused(install: Install) -> None:
    """The values of the function's variables are compiled in, and in no file."""
    install.write("outer", """\
from uw_visibility.compute.jit import njit

def make(number):
    @njit(nogil=True)
    def kernel(x):
        return x + number
    return kernel

try:
    make(1)
except TypeError as error:
    assert "kernel uses variables" in str(error), error
    outer = abs
""")
    assert install.run().value == 3


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
    for useless in (warm.root / "file", Path("chosen")):
        outcome = warm.run(NUMBA_CACHE_DIR=str(useless))
        assert (outcome.folder, outcome.loaded) == (warm.kernels, 1)
        assert "NUMBA_CACHE_DIR" in outcome.said


def test_damaged_files_are_compiled_anew(warm: Install) -> None:
    def flip_a_bit(content: bytes) -> bytes:
        """Change machine code, which ends the process if it is run."""
        middle = len(content) // 2
        return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1:]

    for damage in (lambda _: b"", lambda content: content[:-9] + 9 * b"\0", flip_a_bit):
        for path in files(warm.kernels):
            path.write_bytes(damage(path.read_bytes()))
        outcome = warm.run()
        assert (outcome.value, outcome.compiled) == (107, 3)
        assert outcome.said.count("is damaged") == 3
    healed = warm.run()
    assert (healed.loaded, healed.compiled, healed.said) == (1, 0, "")


def test_a_kernels_file_in_anothers_place_is_not_taken_for_it(warm: Install) -> None:
    (inner,), = [folder.glob("inner-*") for folder in warm.kernels.glob("*.inner-*")]
    (outer,), = [folder.glob("outer-*") for folder in warm.kernels.glob("*.outer-*")]
    shutil.copy(inner, outer)
    assert warm.run().value == 107


def test_a_full_disk_costs_the_cache_alone(install: Install) -> None:
    # /dev/full says so as a full disk does.
    full = (
        "import os\n"
        "open_file = os.fdopen\n"
        "os.fdopen = lambda number, mode: os.close(number) or open('/dev/full', mode)\n"
    )
    outcome = install.run(code=full + CALL)
    assert outcome.value == 107
    assert outcome.said.count("No space left on device") == 1
    assert not files(install.kernels)


def test_other_packages_keep_numbas_own_cache(install: Install) -> None:
    (install.root / "lib" / "other.py").write_text(
        "import numba\n@numba.njit(cache=True)\ndef double(x):\n    return 2 * x\n"
    )
    use = "import other\nassert other.double(4) == 8\n"
    install.run(code=CALL + use)
    assert len(files(install.root / "lib" / "__pycache__")) == 2


def test_every_kernel_has_this_cache() -> None:
    found = 0
    for info in pkgutil.walk_packages(uw_visibility.__path__, "uw_visibility."):
        if info.name.startswith(("uw_visibility.ros", "uw_visibility.replay")):
            continue
        for name, value in vars(importlib.import_module(info.name)).items():
            if isinstance(value, Dispatcher):
                found += 1
                folder = Path(value.stats.cache_path or "").name
                assert folder.startswith(f"{value.py_func.__module__}-"), (info.name, name)
    assert found > 80


def test_kernel_that_cannot_be_kept_runs_with_a_warning(install: Install) -> None:
    # Large arrays are not compiled in, but pointed to; without optimisation, others too.
    install.write("inner", KERNELS["inner"].replace("return 2 * x", "return TWOS[0] * x").replace(
        "@njit", "import numpy as np\nTWOS = np.full(1_000_000, 2)\n\n@njit", 1
    ))
    done = install.run()
    assert done.value == 107
    assert "uw_visibility.inner.helper is compiled at every start" in done.said


@pytest.mark.parametrize("writers", [0o020, 0o002])
def test_a_folder_that_others_may_write_is_not_touched(warm: Install, writers: int) -> None:
    warm.kernels.chmod(0o755 | writers)
    before = files(warm.kernels)
    outcome = warm.run()
    assert (outcome.value, outcome.loaded, outcome.compiled) == (107, 0, 3)
    assert outcome.folder == warm.cache
    assert f"{warm.kernels} are not used" in outcome.said
    assert files(warm.kernels) == before


def test_a_file_that_others_may_write_is_not_run(warm: Install) -> None:
    for path in files(warm.kernels):
        path.chmod(0o666)
    outcome = warm.run()
    assert (outcome.value, outcome.loaded, outcome.compiled) == (107, 0, 3)
    # What took its place may be.
    assert warm.run().loaded == 1


@as_root
@pytest.mark.parametrize("part", ["folder", "files"])
def test_what_belongs_to_another_user_is_not_run(warm: Install, part: str) -> None:
    """Not by root either, who could read and write it."""
    for path in [warm.kernels] if part == "folder" else files(warm.kernels):
        os.chown(path, NOBODY, NOBODY)
    outcome = warm.run()
    assert (outcome.value, outcome.loaded, outcome.compiled) == (107, 0, 3)
    assert f"belongs to another user (number {NOBODY})" in outcome.said
    assert outcome.folder == (warm.cache if part == "folder" else warm.kernels)


@as_root
def test_roots_kernels_serve_all_users_and_a_users_only_that_user(compiled: Path) -> None:
    # Not below pytest's folder, which is root's alone.
    with tempfile.TemporaryDirectory() as name:
        install, cache = Install(Path(name)), Path(name) / "cache"
        shutil.copytree(compiled, install.kernels)
        cache.mkdir()
        for folder in (install.root, cache):
            folder.chmod(0o777 if folder == cache else 0o755)
        # Python's own files may be root's alone too: what is imported is imported before.
        outcome = install.run(code=f"""\
import json, os
from pathlib import Path
from uw_visibility.compute import kernel_folder
from uw_visibility.compute.jit import counts
from uw_visibility.outer import inner, outer
outer(3)
os.setgroups([])
os.setgid({NOBODY})
os.setuid({NOBODY})
for choice in (kernel_folder.writable_folder, kernel_folder.folders):
    choice.cache_clear()
print(json.dumps([inner(3), counts.loaded, counts.compiled, "{cache}"]))
os.umask(0)
kernel_folder.write(Path("{cache}/module-0/kernel"), b"code")
""")
        assert (outcome.value, outcome.loaded, outcome.compiled) == (106, 2, 0)
        written = [cache / "module-0", cache / "module-0" / "kernel"]
        assert [oct(path.stat().st_mode & 0o777) for path in written] == ["0o700", "0o600"]


@pytest.mark.parametrize(
    "settings",
    [
        "disable_jit: 1\ncache_dir: {hostile}\ncache_locator_classes: hostile.Locator\nopt: 0\n",
        "[no mapping]\n",
    ],
)
def test_numbas_settings_in_the_current_folder_change_nothing(
    warm: Install, tmp_path: Path, settings: str
) -> None:
    downloaded = tmp_path / "downloaded"
    downloaded.mkdir()
    hostile = downloaded / "kernels"
    (downloaded / ".numba_config.yaml").write_text(settings.format(hostile=hostile))
    (downloaded / "hostile.py").write_text(f"open({str(downloaded / 'mark')!r}, 'w')\n")
    # Another type is compiled, before which numba reads its settings again.
    check = (
        "assert outer(0.5) == 102.0\n"
        "import numba, os\n"
        "assert not numba.config.DISABLE_JIT and not numba.config.CACHE_DIR\n"
        "assert numba.config.OPT == 3 and os.getcwd().endswith('downloaded')\n"
    )
    outcome = warm.run(code=CALL + check, cwd=downloaded)
    assert (outcome.value, outcome.loaded, outcome.folder) == (107, 1, warm.kernels)
    assert {path.name for path in downloaded.iterdir()} == {".numba_config.yaml", "hostile.py"}


def test_the_users_own_settings_hold(warm: Install) -> None:
    outcome = warm.run(NUMBA_DISABLE_JIT="1")
    assert (outcome.value, outcome.loaded, outcome.compiled) == (107, 0, 0)
