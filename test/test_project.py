# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What services read beside the package: the files and targets that they call are there."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def read(name: str) -> Any:
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def test_what_ci_runs_is_there() -> None:
    jobs = read(".github/workflows/ci.yml")["jobs"].values()
    commands = [step["run"] for job in jobs for step in job["steps"] if "run" in step]
    assert {".ci/run", ".ci/site"} <= set(commands)
    for command in commands:
        if command.startswith("make "):
            assert f"\n{command.split()[1]}:" in MAKEFILE
        else:
            assert (ROOT / command).stat().st_mode & 0o100, command


@pytest.mark.parametrize("script", ["run", "site"])
def test_what_the_scripts_of_ci_make_is_there(script: str) -> None:
    targets = re.findall(r"^make (\w+)$", (ROOT / ".ci" / script).read_text(), flags=re.M)
    assert targets
    assert [target for target in targets if f"\n{target}:" not in MAKEFILE] == []


def test_read_the_docs_installs_what_the_site_needs() -> None:
    settings = read(".readthedocs.yaml")
    assert (ROOT / settings["sphinx"]["configuration"]).is_file()
    assert settings["sphinx"]["fail_on_warning"]
    install, lab = settings["python"]["install"]
    assert lab == {"method": "pip", "path": "lab"}
    extras = re.search(r"make_venv \$\(VENV_DOCS\) .*? (\S+) \$\(INTERPRETERS\)", MAKEFILE)
    assert extras is not None
    # As make docs does.
    assert install["extra_requirements"] == extras[1].split(",")


def test_hooks_are_the_tools_of_make_lint() -> None:
    (repository,) = read(".pre-commit-config.yaml")["repos"]
    linted = re.search(r"^lint: venv\n((?:\t.*\n)+)", MAKEFILE, flags=re.M)
    assert linted is not None
    tools = set(re.findall(r"\$\(VENV\)/bin/(\S+)", linted[1]))
    assert {hook["entry"].split()[0] for hook in repository["hooks"]} == {
        f".venv/bin/{tool}" for tool in tools}


def test_the_container_is_built_of_files_that_are_there() -> None:
    folder = ROOT / ".devcontainer"
    settings = json.loads((folder / "devcontainer.json").read_text(encoding="utf-8"))
    dockerfile = folder / settings["build"]["dockerfile"]
    copied = re.findall(r"^COPY (\S+) ", dockerfile.read_text(encoding="utf-8"), flags=re.M)
    context = folder / settings["build"]["context"]
    assert copied
    assert [name for name in copied if not (context / name).exists()] == []
