# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Where kernels are kept, and whose are run."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.node

NOBODY = 65534
as_root = pytest.mark.skipif(os.getuid() != 0, reason="only root can give files to others")


def test_read_only_install_uses_the_users_folder(install: Any) -> None:
    install.protect(install.package)
    cache = install.root / "cache"
    cache.mkdir()
    first = install.run(XDG_CACHE_HOME=str(cache))
    assert (first.value, first.compiled, first.folder) == (107, 3, cache / "uw_visibility")
    again = install.run(XDG_CACHE_HOME=str(cache))
    assert (again.loaded, again.compiled, again.said) == (1, 0, "")
    assert not install.kernels.exists()


def test_what_came_with_a_read_only_install_is_used(warm: Any) -> None:
    """An administrator warms up the installation; a user without home starts the node."""
    warm.protect(warm.package, warm.home)
    outcome = warm.run()
    assert (outcome.value, outcome.loaded, outcome.compiled) == (107, 1, 0)


def test_without_any_folder_kernels_work_and_the_reason_is_said_once(install: Any) -> None:
    install.protect(install.package, install.home)
    outcome = install.run()
    assert (outcome.value, outcome.compiled, str(outcome.folder)) == (107, 3, "None")
    assert outcome.said.count("NUMBA_CACHE_DIR") == 1


def test_the_users_choice_wins(warm: Any) -> None:
    chosen = warm.root / "chosen"
    outcome = warm.run(NUMBA_CACHE_DIR=str(chosen))
    assert (outcome.folder, outcome.compiled) == (chosen / "uw_visibility", 3)
    assert warm.run(fresh=True, NUMBA_CACHE_DIR=str(chosen)).compiled == 0
    # A choice that cannot be used is said, and the next place taken.
    (warm.root / "file").write_text("")
    for useless in (warm.root / "file", Path("chosen")):
        outcome = warm.run(NUMBA_CACHE_DIR=str(useless))
        assert (outcome.folder, outcome.loaded) == (warm.kernels, 1)
        assert "NUMBA_CACHE_DIR" in outcome.said


def test_kernels_of_modules_that_are_gone_are_deleted_beside_the_package(warm: Any) -> None:
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


def test_what_another_process_has_deleted_first_costs_no_kernel(warm: Any) -> None:
    (kept,) = [path.name for path in warm.kernels.iterdir() if ".outer-" in path.name]
    module, _, version = kept.rpartition("-")
    # It is still listed, and is there no more.
    (warm.kernels / f"{module}-{'0' * len(version)}").symlink_to("nowhere")
    warm.replace("outer", "+ 1", "+ 2")
    assert "cannot keep" not in warm.run().said
    assert warm.run().compiled == 0


@pytest.mark.parametrize("writers", [0o020, 0o002])
def test_a_folder_that_others_may_write_is_not_touched(warm: Any, writers: int) -> None:
    warm.kernels.chmod(0o755 | writers)
    before = warm.stored()
    outcome = warm.run()
    assert (outcome.value, outcome.loaded, outcome.compiled) == (107, 0, 3)
    assert outcome.folder == warm.cache
    assert f"{warm.kernels} are not used" in outcome.said
    assert warm.stored() == before


@as_root
def test_a_folder_that_belongs_to_another_user_is_not_run_from(warm: Any) -> None:
    """Not by root either, who could read and write it."""
    os.chown(warm.kernels, NOBODY, NOBODY)
    outcome = warm.run()
    assert (outcome.value, outcome.loaded, outcome.compiled) == (107, 0, 3)
    assert f"belongs to another user (number {NOBODY})" in outcome.said
    assert outcome.folder == warm.cache


@as_root
def test_roots_kernels_serve_all_users_and_no_other_user_can_write_a_users(
    compiled: Path, make_install: Any
) -> None:
    # Not below pytest's folder, which is root's alone.
    with tempfile.TemporaryDirectory() as name:
        install, cache = make_install(Path(name)), Path(name) / "cache"
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
        assert [oct(path.stat().st_mode & 0o777) for path in written] == ["0o755", "0o644"]
