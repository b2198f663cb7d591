# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The documentation names modules, functions and constants that exist."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from uw_visibility.cli import commands as available
from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.images import ENCODINGS
from uw_visibility.messages.outputs import all_topics

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "uw_visibility"
MODEL = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
NAMES = sorted(set(re.findall(r"`((?:[a-z_]+/)+[a-z_]+)\.([A-Za-z_]\w*)`", MODEL)))


def test_the_model_names_many_things() -> None:
    assert len(NAMES) > 40


@pytest.mark.parametrize(("module", "name"), NAMES)
def test_what_the_model_names_exists(module: str, name: str) -> None:
    if name == "py":
        assert (PACKAGE / f"{module}.py").is_file()
        return
    found = importlib.import_module(f"uw_visibility.{module.replace('/', '.')}")
    assert hasattr(found, name), f"{module} has no {name}"


# What Sphinx makes is no source.
MADE = {"_build", "generated", "tutorials"}
PAGES = sorted(
    file for file in (ROOT / "docs").rglob("*.md")
    if not MADE & set(file.relative_to(ROOT / "docs").parts)
)


@pytest.mark.parametrize("file", PAGES, ids=lambda file: str(file.relative_to(ROOT)))
def test_links_between_files_lead_somewhere(file: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", file.read_text(encoding="utf-8")):
        # A tutorial's page is made of its script.
        source = re.sub(r"tutorials/(\w+)\.rst$", r"examples/\1.py", target)
        assert (file.parent / source).exists(), target


def test_the_matcher_of_the_examples_is_one(tmp_path: Path) -> None:
    script = ROOT / "docs" / "examples" / "6_a_matcher.py"
    run = subprocess.run(
        [sys.executable, script], cwd=tmp_path, env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    shares = [float(share) for share in re.findall(r": ([\d.]+)% of the scene", run.stdout)]
    assert len(shares) == 2
    assert min(shares) > 50


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


def test_the_readme_has_no_long_paragraph() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    prose = re.sub(r"```.*?```", "", text, flags=re.S)
    for paragraph in prose.split("\n\n"):
        lines = [line for line in paragraph.splitlines() if not line.startswith(("|", "- ", "!["))]
        assert len(lines) <= 5, paragraph
        assert all(len(line) <= 105 for line in lines), paragraph


def test_badges_of_the_readme_are_true() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    versions = re.findall(r"Python :: (3\.\d+)", setup)
    assert f"badge/Python-{'_%7C_'.join(versions)}-" in text
    assert "badge/licence-Apache--2.0-" in text
    assert ">Apache-2.0</license>" in (ROOT / "package.xml").read_text(encoding="utf-8")
    workflow = re.search(r"actions/(workflows/[\w.]+)/badge.svg", text)
    assert workflow and (ROOT / ".github" / workflow[1]).exists()


def test_links_of_the_readme_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#:]+)\)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(links) > 20
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_commands_and_targets_of_the_readme_exist() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"(?:^|`)make (\w+)", text, flags=re.M))
    assert targets >= {"demo", "test", "docs"}
    assert {target for target in targets if f"\n{target}:" not in makefile} == set()
    commands = set(re.findall(r"^uw_visibility (\w+)", text, flags=re.M))
    assert commands >= {"enhance", "replay", "calibrate"}
    assert commands <= set(available())
