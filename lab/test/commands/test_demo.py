# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The demonstration in short, through the real node, and how it ends when things go wrong."""

from __future__ import annotations

import csv
import math
import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2")
pytest.importorskip("rosbags")
pytest.importorskip("matplotlib")

from uw_visibility_lab.demonstration.comparison import QUANTITIES, score, summarize, write_results
from uw_visibility_lab.demonstration.node_process import NodeDied, NodeProcess

pytestmark = pytest.mark.node

COMMAND = [sys.executable, "-m", "uw_visibility.cli", "demo"]
ENVIRONMENT = {k: v for k, v in os.environ.items() if not k.startswith("FASTRTPS")}


def nodes_of(folder: Path) -> list[int]:
    """Return processes whose output goes to the folder's log."""
    log = str((folder / "node.log").resolve())
    found = []
    for process in Path("/proc").iterdir():
        try:
            if process.name.isdigit() and str((process / "fd" / "1").readlink()) == log:
                found.append(int(process.name))
        except OSError:
            continue
    return found


@pytest.mark.long
def test_short_demo_through_the_real_node(tmp_path: Path) -> None:
    done = subprocess.run(
        [*COMMAND, "-o", str(tmp_path), "--frames", "3", "--rate", "1"],
        capture_output=True, text=True, timeout=900, env=ENVIRONMENT, check=False,
    )
    log = tmp_path / "node.log"
    assert done.returncode == 0, done.stderr + (log.read_text() if log.exists() else "")
    summary = dict(line.split("  ", 1) for line in done.stdout.splitlines() if "  " in line)
    summary = {name.strip(): value.strip() for name, value in summary.items()}
    assert summary["frames in"] == "3"
    assert int(summary["frames out"]) >= 2
    assert float(summary["mean absolute error of alpha"].split()[0]) < 0.3
    assert float(summary["correct (<= 1 px), after"]) > 0.5
    assert summary["median latency, image to last result"].endswith(" ms")
    rows = list(csv.DictReader((tmp_path / "frames.csv").open(encoding="utf-8")))
    assert [float(row["true_depth"]) for row in rows] == pytest.approx([2, 4, 6])
    answered = [row for row in rows if row["answered"] == "1"]
    assert len(answered) == int(summary["frames out"])
    assert all(float(row["matched_after"]) > 0.3 for row in answered)
    pictures = sorted(tmp_path.glob("frame_*.png"))
    assert len(pictures) == len(answered)
    for picture in [*pictures, tmp_path / "series.png"]:
        assert cv2.imread(str(picture)).std() > 20.0
    assert nodes_of(tmp_path) == []


def test_ending_the_demo_ends_the_node(tmp_path: Path) -> None:
    demo = subprocess.Popen(
        [*COMMAND, "-o", str(tmp_path), "--frames", "500"],
        stderr=subprocess.PIPE, text=True, env=ENVIRONMENT,
    )
    end = time.monotonic() + 120.0
    while not nodes_of(tmp_path) and time.monotonic() < end:
        time.sleep(0.2)
    assert nodes_of(tmp_path)
    demo.send_signal(signal.SIGTERM)
    # It ends after the frame at hand, and before that kernels may have to be compiled.
    _, error = demo.communicate(timeout=600)
    assert demo.returncode == 130
    # Where the machine is busy, it has told before that it still simulates.
    assert error.splitlines()[-1] == "uw_visibility: interrupted"
    assert "Traceback" not in error
    assert nodes_of(tmp_path) == []
    # The recording that was being written is not left behind in part.
    assert not (tmp_path / "transect").exists()


def test_a_killed_demonstration_takes_its_node_along(tmp_path: Path) -> None:
    script = """if True:
        import sys, time
        from pathlib import Path
        from uw_visibility_lab.demonstration.node_process import NodeProcess

        node = (sys.executable, "-c", "import time; print('here', flush=True); time.sleep(60)")
        with NodeProcess(Path(sys.argv[1]), 1, node):
            time.sleep(60)
    """
    log = tmp_path / "node.log"
    demo = subprocess.Popen([sys.executable, "-c", script, str(log)], env=ENVIRONMENT)
    end = time.monotonic() + 60.0
    while time.monotonic() < end and not (log.exists() and log.read_text()):
        time.sleep(0.05)
    (node,) = nodes_of(tmp_path)
    demo.kill()
    demo.wait()
    while nodes_of(tmp_path) and time.monotonic() < end:
        time.sleep(0.05)
    left = nodes_of(tmp_path)
    if left:
        os.kill(node, signal.SIGKILL)
    assert left == []


def test_a_node_that_dies_is_told_with_its_last_lines(tmp_path: Path) -> None:
    script = "print('the lens is fogged', flush=True); raise SystemExit(7)"
    with NodeProcess(tmp_path / "node.log", 1, (sys.executable, "-c", script)) as node:
        with pytest.raises(NodeDied, match="exit code 7") as caught:
            for _ in range(300):
                node.check()
                time.sleep(0.1)
        assert "the lens is fogged" in str(caught.value)


def test_the_node_runs_nothing_from_the_current_folder(
    hostile_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(hostile_folder)
    log = hostile_folder / "node.log"
    with NodeProcess(log, int(ENVIRONMENT["ROS_DOMAIN_ID"])) as node:
        for _ in range(300):
            node.check()
            if "preparing the pipeline" in log.read_text(encoding="utf-8"):
                break
            time.sleep(0.1)
    assert not (hostile_folder / "ran").exists()


def test_the_demo_of_a_dead_node_exits_with_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from uw_visibility.cli import main
    from uw_visibility_lab.demonstration import run

    def die(*_: object, **__: object) -> None:
        raise NodeDied("the node ended with exit code 7; its last lines were\n  fogged")

    monkeypatch.setattr(run, "demonstrate", die)
    with pytest.raises(SystemExit) as caught:
        main(["demo", "-o", str(tmp_path)])
    assert caught.value.code == 1
    assert "fogged" in capsys.readouterr().err


def test_a_node_that_does_not_listen_is_ended_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uw_visibility_lab.demonstration.node_process.PATIENCE", 0.5)
    script = (
        "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); "
        "print('deaf', flush=True); time.sleep(60)"
    )
    log = tmp_path / "node.log"
    with NodeProcess(log, 1, (sys.executable, "-c", script)) as node:
        for _ in range(300):
            if log.read_text(encoding="utf-8"):
                break
            time.sleep(0.1)
        node.check()
    assert nodes_of(tmp_path) == []


def test_options_that_cannot_be_used_are_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from uw_visibility.cli import main

    assert main(["demo", "-o", str(tmp_path / "out"), "--frames", "0"]) == 2
    (tmp_path / "file").write_text("x", encoding="utf-8")
    assert main(["demo", "-o", str(tmp_path / "file" / "out")]) == 2
    error = capsys.readouterr().err
    assert "frames" in error
    assert str(tmp_path / "file" / "out") in error
    assert error.count("\n") == 2


def test_score_counts_pixels_with_truth_only() -> None:
    nan = np.nan
    truth = np.array([[10.0, 20.0, 30.0, 40.0, nan]], np.float32)
    found = np.array([[10.9, 22.0, nan, 40.0, 5.0]], np.float32)
    assert score(found, truth) == pytest.approx((0.75, 0.5))


def test_summary_is_over_the_frames_that_were_answered() -> None:
    def row(**known: float) -> dict[str, float]:
        return defaultdict(lambda: math.nan, known)

    rows = [
        row(answered=1, latency=100.0, mean_attenuation=0.15, true_mean_attenuation=0.1,
            depth=3.0, true_depth=2.5, matched_before=0.5, matched_after=0.7,
            correct_before=0.4, correct_after=0.6),
        row(answered=1, latency=300.0, true_mean_attenuation=0.1, true_depth=2.5,
            matched_before=0.3, matched_after=0.9, correct_before=0.2, correct_after=0.8),
        row(answered=0, matched_before=1.0, correct_before=1.0),
    ]
    summary = dict(summarize(rows))
    assert summary["frames in"] == "3"
    assert summary["frames out"] == "2"
    assert summary["of these assessed"] == "1"
    assert summary["mean absolute error of alpha"] == "0.050 1/m"
    assert summary["mean absolute error of depth"] == "0.50 m"
    assert summary["matched, before enhancement"] == "0.400"
    assert summary["correct (<= 1 px), after"] == "0.700"
    assert summary["median latency, image to last result"] == "200 ms"
    assert dict(summarize([rows[2]]))["mean absolute error of alpha"] == "not assessed"


def test_a_frame_without_an_answer_is_not_shown_as_refused(tmp_path: Path) -> None:
    def row(time: float, answered: int, value: float) -> dict[str, float]:
        known = {"time": time, "answered": answered}
        for name in QUANTITIES:
            known |= {name: value, f"{name}_stddev": 0.1 * value, f"true_{name}": 1.0}
        return known

    red = {}
    for name, answered in (("late", 0), ("refused", 1)):
        folder = tmp_path / name
        folder.mkdir()
        write_results(folder, [row(0.0, 1, 1.0), row(1.0, answered, math.nan), row(2.0, 1, 1.0)])
        blue, green, of_red = np.moveaxis(cv2.imread(str(folder / "series.png")).astype(int), -1, 0)
        red[name] = np.count_nonzero((of_red > 190) & (green < 50) & (blue < 50))
    assert red["late"] == 0 < red["refused"]
