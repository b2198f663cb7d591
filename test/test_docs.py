# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The documentation names modules, functions and constants that exist."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

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
