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
