# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The site's reference holds all that the code offers; `make docs` builds it."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

import uw_visibility
import uw_visibility.replay
from uw_visibility.cli import commands, make_parser
from uw_visibility.config.parameters import describe
from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.messages import synchronizer
from uw_visibility.messages.outputs import all_topics
from uw_visibility.plausibility.comparison import Verdict
from uw_visibility.replay.columns import COLUMNS
from uw_visibility.status import Status

DOCS = Path(__file__).resolve().parents[1] / "docs"


def load_generator() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "reference_pages", DOCS / "_ext" / "reference_pages.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    """The generated parts of the reference, as Sphinx includes them."""
    made: dict[str, str] = load_generator().pages()
    return made


def written(name: str) -> str:
    return (DOCS / "reference" / name).read_text(encoding="utf-8")


def rows(page: str) -> dict[str, list[str]]:
    """Cells of a page's tables by their first one, with the markup taken off."""
    lines = [line for line in page.splitlines() if line.startswith("| ")]
    cells = [re.split(r" ?(?<!\\)\| ?", line)[1:-1] for line in lines]
    return {c[0].strip("`"): [re.sub(r"\\(.)", r"\1", cell) for cell in c] for c in cells}


def test_every_parameter_has_its_default_its_bounds_and_its_meaning(pages: dict[str, str]) -> None:
    table = rows(pages["parameters.md"])
    for info in (*describe(PipelineConfig), *describe(NodeConfig)):
        _, default, allowed, meaning = table[info.name]
        assert meaning == " ".join(info.description.split())
        assert default
        for bound in (info.minimum, info.maximum):
            assert bound is None or f"{bound:g}" in allowed
        assert all(choice in allowed for choice in info.choices)
        assert info.unit in allowed
        assert ("at start only" in allowed) == info.read_only
    assert table["camera.transfer"][1:3] == ["`linear`", "`linear`, `srgb`"]


def test_every_command_has_its_options(pages: dict[str, str]) -> None:
    sections = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", pages["commands.md"], re.M | re.S))
    assert set(sections) == set(commands())
    assert "`--marine-snow SHARE`" in sections["simulate"]
    assert "`--marine-snow SHARE`" not in sections["enhance"]
    for name, section in sections.items():
        usage = next(
            action for action in make_parser()._actions if action.choices and name in action.choices
        ).choices[name].format_usage()
        for option in set(re.findall(r"--[a-z][a-z-]*", usage)) - {"--debug"}:
            assert re.search(rf"^\| `[^`]*{option}[ ,`]", section, re.M), (name, option)


def test_every_status_says_what_to_do(pages: dict[str, str]) -> None:
    told = {cells[0]: cells[1:] for cells in rows(pages["statuses.md"]).values()}
    for status in set(Status) - {Status.OK}:
        meaning, remedy = told[f"{status} (`{status.name.lower()}`)"]
        assert len(meaning.split()) > 3, status
        assert len(remedy.split()) > 3, status


def test_every_verdict_and_every_topic_is_there(pages: dict[str, str]) -> None:
    assert set(rows(pages["verdicts.md"])) >= {str(verdict) for verdict in Verdict}
    config = NodeConfig(publish_depth_image=True, publish_points=True)
    topics = {t: kind.replace("/msg/", "/") for t, kind in all_topics(config).items()}
    table = rows(pages["topics.md"])
    assert {t: table[t][1].strip("`") for t in topics} == topics


def test_every_reason_of_the_synchroniser_is_there() -> None:
    page = written("statuses.md")
    tree = ast.parse(Path(str(synchronizer.__file__)).read_text(encoding="utf-8"))
    calls = [
        node for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "_drop"
    ]
    texts = {
        part.value.strip()
        for call in calls for part in ast.walk(call.args[0])
        if isinstance(part, ast.Constant) and len(str(part.value).split()) > 1
    }
    assert len(texts) >= 6
    assert {text for text in texts if f"{text.removeprefix('image ')}" not in page} == set()


def test_every_column_of_the_table_is_there(pages: dict[str, str]) -> None:
    table = {name.partition("`")[0]: cells for name, cells in rows(pages["columns.md"]).items()}
    assert "filtered_visibility_distance" in table
    for name, column in COLUMNS.items():
        if column.stddev_of:
            assert "…_stddev" in table[column.stddev_of][0]
        else:
            assert column.title in table[name][2]
            assert column.unit in ("1", table[name][1])


def listed() -> list[str]:
    """Names that the library's page lists, in full."""
    module, names = "", []
    for line in written("api.rst").splitlines():
        if line.startswith(".. currentmodule:: "):
            module = line.removeprefix(".. currentmodule:: ")
        found = re.match(r"\.\. auto(?:class|function|data|exception):: ([\w.]+)", line)
        if found:
            name = found.group(1)
            names.append(name if name.startswith("uw_visibility") else f"{module}.{name}")
    return names


def test_every_public_name_is_on_the_library_page() -> None:
    public = {f"uw_visibility.{name}" for name in uw_visibility.__all__}
    public |= {f"uw_visibility.replay.{name}" for name in uw_visibility.replay.__all__}
    assert public - set(listed()) == set()


@pytest.mark.parametrize("name", listed())
def test_what_the_library_page_lists_is_there_and_documented(name: str) -> None:
    module, _, attribute = name.rpartition(".")
    found = getattr(importlib.import_module(module), attribute)
    assert (found.__doc__ or "").strip(), name


def test_who_adds_nothing_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sphinx reads anew what was written anew."""
    generator = load_generator()
    monkeypatch.setattr(generator, "FOLDER", tmp_path / "generated")
    generator.write()
    before = {file: file.stat().st_mtime_ns for file in (tmp_path / "generated").iterdir()}
    generator.write()
    assert {file: file.stat().st_mtime_ns for file in before} == before
    assert len(before) == len(generator.pages())
