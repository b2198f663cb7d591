# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The node brings memory for its messages, unless somebody has set up the middleware."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from uw_visibility.ros.transport.middleware import (
    PROFILES,
    PROFILES_VARIABLE,
    give_memory,
    scarce_memory,
)


def test_memory_is_given_for_a_whole_frame(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    environment: dict[str, str] = {}
    assert give_memory(environment)
    assert environment == {PROFILES_VARIABLE: str(PROFILES)}
    size = re.search(r"<segment_size>(\d+)</segment_size>", PROFILES.read_text(encoding="utf-8"))
    # Two enhanced images and the disparity.
    assert size is not None and int(size[1]) > 640 * 480 * (3 + 3 + 4)


@pytest.mark.parametrize("name", [
    PROFILES_VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS",
    "SKIP_DEFAULT_XML_FILE",
])
def test_what_the_environment_says_holds(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    environment = {name: "given"}
    assert not give_memory(environment)
    assert environment == {name: "given"}


def test_what_the_current_folder_says_holds(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").touch()
    environment: dict[str, Any] = {}
    assert not give_memory(environment)
    assert environment == {}


def test_too_little_memory_for_sockets_is_said_with_its_remedy(tmp_path: Path) -> None:
    allowed = tmp_path / "rmem_max"
    assert scarce_memory(allowed) == ""
    allowed.write_text("212992\n")
    assert "208 KiB" in scarce_memory(allowed)
    assert "sysctl -w net.core.rmem_max=" in scarce_memory(allowed)
    allowed.write_text("4194304\n")
    assert scarce_memory(allowed) == ""
