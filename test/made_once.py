# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What takes long is made by one worker of pytest-xdist, and read by all, or left out."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest


def made_once(
    factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]
) -> Path:
    """Return a folder, not to be changed, that `make` has filled in this run of the tests."""
    base = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        # The workers' own folders are in one.
        base = base.parent
    folder, whole = base / name, base / f"{name}.whole"
    with (base / f"{name}.lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not whole.exists():
            # What another worker failed in the middle of.
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            whole.touch()
    return folder


def leave_out_figures(patch: pytest.MonkeyPatch, *pages: str) -> None:
    """Draw no series and no maps on pages, modules of `replay`: it takes longer than all else."""
    for page in pages:
        for name in ("draw_series", "draw_tracks"):
            patch.setattr(f"uw_visibility.replay.{page}.{name}", lambda *_: [])
