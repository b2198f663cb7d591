# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings on a Dask cluster: the same results as without it, and as with a lost worker."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from bag_copies import copy_bag
from made_once import leave_out_figures

from uw_visibility.cli import main
from uw_visibility.replay import cluster as replay_cluster
from uw_visibility.replay.frame_log import NAME

pytestmark = [
    pytest.mark.node,
    # Imported by the tests that need it: that takes long.
    pytest.mark.skipif(
        find_spec("distributed") is None, reason="the extra distributed is not installed")]


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two workers, each a process, as on two machines with one folder."""
    import distributed

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None,
    ) as started:
        with distributed.Client(started.scheduler_address, set_as_default=False) as client:
            # The series of a report takes longer than all else.
            client.run(exec, "from uw_visibility.replay.report import report\n"
                             "report.draw_series = lambda columns: []")
        yield started


@pytest.fixture(scope="module")
def alone(
    transect: Path, dive: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, bytes]:
    """What one process writes of two recordings."""
    out = tmp_path_factory.mktemp("alone") / "day"
    with pytest.MonkeyPatch.context() as patch:
        leave_out_figures(patch, "report.report", "day")
        assert main(["replay", str(transect), str(dive), "-o", str(out), "--jobs", "1"]) == 0
    return written(out)


def written(out: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in sorted(out.rglob("frames.csv"))
    }


def test_a_cluster_makes_the_same_results(
    transect: Path, dive: Path, alone: dict[str, bytes], cluster: Any, tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "day"
    pytest.importorskip("netCDF4", reason="the extra netcdf is not installed")
    command = ["replay", str(transect), str(dive), "-o", str(out), "--netcdf", "--scheduler",
               cluster.scheduler_address]
    assert main(command) == 0
    assert written(out) == alone
    assert len(alone) == 3
    assert len(list(out.rglob("frames.nc"))) == 3
    assert (out / "index.html").is_file()
    assert "2 of 2 recordings" in capfd.readouterr().err
    # What is there is not replaced, and not made again.
    assert main(command) == 2
    assert main([*command, "--resume"]) == 0
    assert "12 of them from before" in capfd.readouterr().out


def test_workers_take_recordings_from_a_store_and_put_results_there(
    transect: Path, dive: Path, alone: dict[str, bytes], cluster: Any, tmp_path: Path
) -> None:
    pytest.importorskip("fsspec", reason="the extra stores is not installed")
    out = tmp_path / "day"
    assert main([
        "replay", transect.as_uri(), dive.as_uri(), "-o", out.as_uri(), "--scheduler",
        cluster.scheduler_address]) == 0
    assert written(out) == alone
    assert (out / "index.html").is_file()


@pytest.mark.long
def test_what_lost_workers_left_is_gone_on_with(
    transect: Path, dive: Path, alone: dict[str, bytes], cluster: Any, tmp_path: Path
) -> None:
    from distributed import Client

    out, killed = tmp_path / "day", []

    def begun() -> bool:
        """Whether a worker is within a recording; its folder may get its name meanwhile."""
        try:
            return any(path.stat().st_size for path in out.rglob(f"*.partial/{NAME}"))
        except FileNotFoundError:
            return False

    def kill() -> None:
        """End the workers by force once one of them is within a recording."""
        # What else runs here must not take it for its own.
        with Client(cluster.scheduler_address, set_as_default=False) as client:
            processes = client.run(os.getpid)
            for _ in range(3000):
                if begun():
                    break
                time.sleep(0.01)
            for process in processes.values():
                os.kill(process, signal.SIGKILL)
                killed.append(process)

    killer = threading.Thread(target=kill)
    killer.start()
    command = ["replay", str(transect), str(dive), "-o", str(out), "--scheduler",
               cluster.scheduler_address]
    assert main(command) == 0
    killer.join()
    assert len(killed) == 2
    assert written(out) == alone
    assert not list(out.glob("*.partial*"))


def test_a_partial_result_from_before_is_not_gone_on_from_unasked(
    transect: Path, dive: Path, cluster: Any, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "day"
    (out / "transect.partial").mkdir(parents=True)
    command = ["replay", str(transect), str(dive), "-o", str(out), "--scheduler",
               cluster.scheduler_address]
    assert main(command) == 2
    assert "transect.partial is a partial result: --resume continues it" in capsys.readouterr().err
    assert not (out / "dive").exists()


def test_workers_of_another_version_are_refused(
    transect: Path, tmp_path: Path, cluster: Any, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(replay_cluster, "__version__", "0.0.1")
    bag = copy_bag(transect, tmp_path / "bag")
    assert main(["replay", str(bag), "-o", str(tmp_path / "out"), "--scheduler",
                 cluster.scheduler_address]) == 2
    assert "this machine 0.0.1: install one version" in capsys.readouterr().err


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:9", "tls://127.0.0.1:9", "tls://", "ucx://127.0.0.1:9"])
def test_a_scheduler_that_is_not_there_is_named(
    address: str, transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("uw_visibility.replay.cluster.TIMEOUT", "0.3s")
    command = ["replay", str(transect), "-o", str(tmp_path / "out")]
    assert main([*command, "--scheduler", address]) == 2
    assert f"cannot reach the scheduler {address}: " in capsys.readouterr().err
