# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The documentation names modules, functions and constants that exist."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.images import ENCODINGS
from uw_visibility.messages.outputs import all_topics

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "uw_visibility"
MODEL = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
NAMES = sorted(set(re.findall(r"`((?:[a-z_]+/)+[a-z_]+)\.([A-Za-z_]\w*)`", MODEL)))


def test_the_model_names_many_things() -> None:
    assert len(NAMES) > 50


@pytest.mark.parametrize(("module", "name"), NAMES)
def test_what_the_model_names_exists(module: str, name: str) -> None:
    if name == "py":
        assert (PACKAGE / f"{module}.py").is_file()
        return
    found = importlib.import_module(f"uw_visibility.{module.replace('/', '.')}")
    assert hasattr(found, name), f"{module} has no {name}"


@pytest.mark.parametrize("file", sorted((ROOT / "docs").glob("*.md")), ids=lambda file: file.name)
def test_links_between_files_lead_somewhere(file: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", file.read_text(encoding="utf-8")):
        assert (file.parent / target).exists(), target


def test_every_topic_is_in_the_page_of_the_node() -> None:
    page = (ROOT / "docs" / "node.md").read_text(encoding="utf-8")
    config = NodeConfig(publish_depth_image=True, publish_points=True)
    topics = {topic for topic in all_topics(config) if not topic.startswith("visibility/raw/")}
    assert {topic for topic in topics if f"`{topic}`" not in page} == set()
    for encoding in ENCODINGS:
        assert f"`{encoding}`" in page or encoding.startswith("bayer_")


def test_every_launch_argument_is_in_the_page_of_the_node() -> None:
    page = (ROOT / "docs" / "node.md").read_text(encoding="utf-8")
    launch = (ROOT / "launch" / "uw_visibility.launch.py").read_text(encoding="utf-8")
    arguments = re.findall(r'DeclareLaunchArgument\(\s*"(\w+)"', launch)
    assert len(arguments) == 13
    assert [name for name in arguments if f"`{name}`" not in page] == []
