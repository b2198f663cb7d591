# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What is set up for nav2, diagnostics, RViz, systemd and Docker is what the node has."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.outputs import all_topics
from uw_visibility.ros.start import node_environment

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "integration"


def load(name: str) -> Any:
    return yaml.safe_load((FOLDER / name).read_text(encoding="utf-8"))


def test_every_file_is_on_the_page_about_them() -> None:
    page = (ROOT / "docs/operation/integration.md").read_text(encoding="utf-8")
    assert [file.name for file in FOLDER.iterdir() if file.name not in page] == []


def test_the_lifecycle_manager_asks_the_managed_node_for_no_bond() -> None:
    ((name, block),) = load("lifecycle_manager.yaml").items()
    assert block["ros__parameters"] == {
        "autostart": True, "node_names": ["uw_visibility"], "bond_timeout": 0.0}
    assert f"__node:={name}" in (ROOT / "docs/operation/integration.md").read_text()


def test_the_aggregator_takes_the_names_that_the_node_gives() -> None:
    analyzer = load("diagnostic_aggregator.yaml")["/**"]["ros__parameters"]["uw_visibility"]
    source = (ROOT / "uw_visibility/ros/monitor.py").read_text(encoding="utf-8")
    assert 'name=f"{prefix}: {part}"' in source
    for name in ("uw_visibility: input", "auv/uw_visibility: plausibility"):
        assert any(words in name for words in analyzer["contains"])


def test_rviz_shows_topics_that_there_are_in_displays_for_them() -> None:
    topics = all_topics(NodeConfig(publish_depth_image=True, publish_points=True))
    shown = {
        display["Topic"]["Value"]: display["Class"].rpartition("/")[2]
        for display in load("uw_visibility.rviz")["Visualization Manager"]["Displays"]
        if "Topic" in display}
    assert len(shown) == 4
    for topic, kind in shown.items():
        # Displays are named as messages are.
        assert topics[topic].rpartition("/")[2].startswith(kind)


def test_the_frame_beside_an_optical_one_points_ahead() -> None:
    page = (ROOT / "docs/operation/integration.md").read_text(encoding="utf-8")
    angles = re.search(r"--roll (\S+) --pitch (\S+) --yaw (\S+) ", page)
    assert angles is not None
    axes = Rotation.from_euler("xyz", [float(angle) for angle in angles.groups()]).as_matrix()
    # Ahead, left and up in a frame of right, down and ahead (REP 103).
    np.testing.assert_allclose(axes.T, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-6)


def test_the_service_starts_the_node_as_the_launch_files_do() -> None:
    parser = configparser.RawConfigParser(strict=False)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    text = (FOLDER / "uw_visibility.service").read_text(encoding="utf-8")
    parser.read_string(text)
    given = dict(
        pair.split("=") for line in re.findall(r"^Environment=(.*)$", text, flags=re.M)
        for pair in line.split())
    assert given == node_environment({})
    assert parser["Service"]["RestartPreventExitStatus"] == "2"
    executable = re.search(r"/lib/uw_visibility/(\w+)", parser["Service"]["ExecStart"])
    assert executable is not None
    assert f'"{executable[1]} = ' in (ROOT / "setup.py").read_text().replace(
        "f\"uw_visibility", "\"uw_visibility")


def test_systemd_takes_the_service(tmp_path: Path) -> None:
    command = shutil.which("systemd-analyze")
    if command is None:
        pytest.skip("systemd-analyze is not installed")
    # It asks whether the user is there, too.
    text = (FOLDER / "uw_visibility.service").read_text(encoding="utf-8")
    (tmp_path / "uw_visibility.service").write_text(text.replace("User=ros", "User=root"))
    done = subprocess.run(
        [command, "verify", "--man=no", str(tmp_path / "uw_visibility.service")],
        capture_output=True, text=True, check=False)
    assert "uw_visibility.service" not in done.stdout + done.stderr


def test_the_image_copies_what_there_is_and_starts_a_launch_file() -> None:
    text = (FOLDER / "Dockerfile").read_text(encoding="utf-8")
    assert text.count("FROM ros:jazzy\n") == 1
    for name in re.findall(r"^COPY (\S+) ", text, flags=re.M):
        assert (ROOT / name).exists()
    launched = re.search(r'^CMD \[.*"(\S+)"\]$', text, flags=re.M)
    assert launched is not None
    assert (ROOT / "launch" / launched[1]).is_file()
