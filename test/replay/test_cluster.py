# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings on a Dask cluster: the same results as without it."""

from __future__ import annotations

from pathlib import Path

import pytest

from uw_visibility.cli import main

distributed = pytest.importorskip("distributed", reason="the extra distributed is not installed")


def test_a_cluster_makes_the_same_results(transect: Path, replayed: Path, tmp_path: Path) -> None:
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
    ) as cluster:
        address = cluster.scheduler_address
        out = tmp_path / "out"
        assert main(["replay", str(transect), "-o", str(out), "--scheduler", address]) == 0
        assert (out / "frames.csv").read_bytes() == (replayed / "frames.csv").read_bytes()
        assert main(["replay", str(transect), "-o", str(out), "--scheduler", address]) == 2


def test_a_scheduler_that_is_not_there_is_named(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("uw_visibility.replay.cluster.TIMEOUT", "1s")
    command = ["replay", str(transect), "-o", str(tmp_path / "out")]
    assert main([*command, "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "cannot reach the scheduler" in capsys.readouterr().err
