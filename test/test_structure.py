# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The shape of the sources that no other tool holds them to; the layers are import-linter's."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "uw_visibility"
FILES = sorted(PACKAGE.rglob("*.py"))
FOLDERS = sorted({file.parent for file in FILES})


def name_of(path: Path) -> str:
    return str(path.relative_to(PACKAGE.parent))


@pytest.mark.parametrize("folder", FOLDERS, ids=name_of)
def test_a_folder_says_in_one_line_what_it_is_for(folder: Path) -> None:
    tree = ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))
    first = (ast.get_docstring(tree) or "").partition("\n")[0]
    assert len(first.split()) > 3, first
    assert first.endswith(".")


def test_the_top_holds_folders_and_little_else() -> None:
    top = {file.stem for file in PACKAGE.glob("*.py")}
    assert top == {"__init__", "cli", "errors", "status"}


def kernels(file: Path) -> list[ast.FunctionDef]:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return [
        node for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and any("njit" in ast.unparse(decorator) for decorator in node.decorator_list)
    ]


@pytest.mark.parametrize("file", [f for f in FILES if kernels(f)], ids=name_of)
def test_arrays_of_kernels_are_annotated_as_any(file: Path) -> None:
    """Numba takes any array; which one is meant, the docstring says."""
    for kernel in kernels(file):
        written = [a.annotation for a in kernel.args.args] + [kernel.returns]
        names = ["nothing" if w is None else ast.unparse(w) for w in written]
        assert not [n for n in names if "NDArray" in n or n == "nothing"], (kernel.name, names)
