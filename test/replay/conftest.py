# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A short transect, recorded once, and its replay."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

pytest.importorskip("rosbags")

# The tests here share what makes bags; pytest's import mode leaves this folder out.
sys.path.insert(0, str(Path(__file__).parent))

from bag_copies import (
    DIVE_FRAMES,
    FRAMES,
    HARD_PARAMETERS,
    copy_bag,
    disturbed,
    parameter_file,
)
from made_once import leave_out_figures, made_once

from uw_visibility.cli import main
from uw_visibility_lab.simulation.bag import write_transect
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.transect import Transect


def simulated(
    factory: pytest.TempPathFactory, name: str, frames: int, depth: tuple[float, float],
    attenuation: tuple[float, float],
) -> Path:
    def make(folder: Path) -> None:
        write_transect(folder / "simulated", Transect(
            frames=frames, rate=2.0, depth=depth, attenuation=attenuation,
            camera=StereoCamera(160, 120, 150.0, 0.12),
        ))
        copy_bag(folder / "simulated", folder / name)

    return made_once(factory, name, make) / name


@pytest.fixture(autouse=True)
def plain_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the figures of pages out.

    Results that several tests share, such as `replayed`, are made before and have them; test_report
    draws figures by themselves.
    """
    leave_out_figures(monkeypatch, "report.report", "day")


@pytest.fixture(scope="session")
def transect(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag (mcap) of a few small frames, without the truth."""
    return simulated(tmp_path_factory, "transect", FRAMES, (3.0, 4.0), (0.1, 0.2))


@pytest.fixture(scope="session")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag (mcap) of more frames, over some metres of depth, without the truth."""
    return simulated(tmp_path_factory, "dive", DIVE_FRAMES, (2.0, 6.0), (0.1, 0.25))


@pytest.fixture(scope="session")
def replayed(transect: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The transect's replay."""
    def make(folder: Path) -> None:
        assert main(["replay", str(transect), "-o", str(folder / "out"), "--jobs", "1"]) == 0

    return made_once(tmp_path_factory, "replayed", make) / "out"


@pytest.fixture(scope="session")
def hard(dive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dive, with a frame that is unusable and a clock that is set back."""
    return made_once(
        tmp_path_factory, "hard",
        lambda folder: copy_bag(dive, folder / "hard", edit=disturbed)) / "hard"


@pytest.fixture(scope="session")
def hard_replayed(hard: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its replay, with a bias of the sensor that is learned."""
    def make(folder: Path) -> None:
        params = parameter_file(folder / "p.yaml", HARD_PARAMETERS)
        command = ["replay", str(hard), "-o", str(folder / "out"), "--jobs", "1"]
        with pytest.MonkeyPatch.context() as patch:
            leave_out_figures(patch, "report.report")
            assert main([*command, "--params-file", params]) == 0

    return made_once(tmp_path_factory, "hard_replayed", make) / "out"


@pytest.fixture
def copied(transect: Path, tmp_path: Path) -> Path:
    """A copy of the transect to be damaged."""
    return Path(shutil.copytree(transect, tmp_path / "bag"))
