# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the start of a process is spared: it decides how soon the first frame is answered."""

from __future__ import annotations

import subprocess
import sys

import pytest

import uw_visibility
from uw_visibility.config.parameters import describe
from uw_visibility.config.schema import PipelineConfig


def imported_by(statement: str) -> set[str]:
    """Return the modules that a new process has imported after a statement."""
    code = f"{statement}; import sys; print(*sys.modules)"
    return set(subprocess.check_output([sys.executable, "-c", code], text=True).split())


def test_what_needs_no_kernels_imports_none() -> None:
    """The wheels of rclpy restart the interpreter: what comes before is done twice."""
    assert not imported_by("import uw_visibility.cli") & {"numpy", "numba", "cv2", "scipy"}


def test_the_pipeline_does_without_what_takes_longest_to_import() -> None:
    modules = imported_by("from uw_visibility import Pipeline")
    assert "numba" in modules
    assert not modules & {"scipy.stats", "scipy.optimize", "scipy.spatial", "matplotlib"}


def test_the_library_is_there_by_its_names() -> None:
    for name in uw_visibility.__all__:
        assert getattr(uw_visibility, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'Pipelin'"):
        uw_visibility.Pipelin  # noqa: B018


def test_parameters_are_described_once() -> None:
    """A node checks all of them with each that it declares: it took two seconds."""
    assert describe(PipelineConfig) is describe(PipelineConfig)


def test_what_flies_does_without_the_lab() -> None:
    """Installed alone, by colcon or pip, the package has no lab beside it."""
    pytest.importorskip("rclpy", reason="ROS is not installed")
    blocked = "import sys; sys.modules['uw_visibility_lab'] = None"
    modules = imported_by(
        f"{blocked}; import uw_visibility.ros.node, uw_visibility.ros.lifecycle, "
        "uw_visibility.replay.batch, uw_visibility.commands.calibrate")
    assert not [name for name in modules if name.startswith("uw_visibility_lab.")]


def test_a_command_of_the_lab_says_how_to_install_it() -> None:
    code = (
        "import importlib.metadata as m; m.entry_points = lambda **_: (); "
        "from uw_visibility.cli import main; sys = __import__('sys'); "
        "sys.exit(main(['simulate', '-o', 'bag', '--frames', '3']))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "pip install ./lab" in done.stderr
    assert len(done.stderr.splitlines()) == 1
