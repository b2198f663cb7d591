# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The shape of the sources that no other tool holds them to; the layers are import-linter's."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "uw_visibility"
FILES = sorted(PACKAGE.rglob("*.py"))
FOLDERS = sorted({file.parent for file in FILES})
# To parse all files takes seconds, which each process that collects tests would spend.
MAY_HAVE_KERNELS = [file for file in FILES if "njit" in file.read_text(encoding="utf-8")]


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
    assert top == {"__init__", "__main__", "cli", "errors", "status"}


@functools.cache
def kernels(file: Path) -> list[ast.FunctionDef]:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return [
        node for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and any("njit" in ast.unparse(decorator) for decorator in node.decorator_list)
    ]


@pytest.mark.parametrize("file", MAY_HAVE_KERNELS, ids=name_of)
def test_arrays_of_kernels_are_annotated_as_any(file: Path) -> None:
    """Numba takes any array; which one is meant, the docstring says."""
    for kernel in kernels(file):
        written = [a.annotation for a in kernel.args.args] + [kernel.returns]
        names = ["nothing" if w is None else ast.unparse(w) for w in written]
        assert not [n for n in names if "NDArray" in n or n == "nothing"], (kernel.name, names)


# Conversions to whole numbers that may serve as indices; of a float they are undefined beyond the
# range of their type.
CONVERSIONS = re.compile(r"(np\.)?(int|round|u?int32|u?int64|u?intp)$")
# Names, of arrays too, that stand for whole numbers in all kernels.
WHOLE_NAMES = {
    "DISPARITY_BITS", "_BARRED", "_ROUNDS", "above", "at", "before", "after", "below", "best_left",
    "blue", "code", "colours", "column", "count", "d", "descriptors", "energy", "entry", "first",
    "green", "held", "here", "i", "k", "key", "marks", "max_gap", "peek", "shift", "start", "steps",
    "symbol", "to", "total", "u", "v", "x", "y",
}
# Whole numbers by other words: the sizes of arrays, masked to a table of that size, or written by
# `index_of` before.
WHOLE = {
    "enhancement/radiance.py": {"code[c, x]"},
    "images/jpeg_scan.py": {"value", "symbol if k == 0 else symbol & 15"},
    "images/noise.py": {"image[y, x, channel]", "image[y - 1, x, channel]",
                        "image[y + 1, x, channel]", "image[y, x - 1, channel]",
                        "image[y, x + 1, channel]"},
    "simulation/noise.py": {"fx", "fy", "fz"},
    "simulation/scene.py": {"extent[0] / SPACING", "extent[1] / SPACING"},
    "stereo/denoising.py": {"place[x]", "scales.shape[0] - 2"},
    "stereo/elas/confidence.py": {"max(column[x], 0)"},
    "stereo/elas/postprocess.py": {"max(column[x] + 1, 0)"},
    "stereo/elas/semi_global.py": {
        "abs(k - middle)", "apart", "scale",
        "(key >> 8 << dense.DISPARITY_BITS) + (key & 255) + first"},
    "stereo/elas/support.py": {"abs(after - before) >> 1"},
}


def is_whole(argument: ast.expr, listed: set[str]) -> bool:
    """Tell whether a conversion's argument is a whole number, by the lists above."""
    written = ast.unparse(argument)
    names = {node.id for node in ast.walk(argument) if isinstance(node, ast.Name)}
    plain = not re.search(r"\.|(?<!/)/(?!/)|\w\(", re.sub(r"np\.u?int\d+\(", "(", written))
    whole = plain and names <= WHOLE_NAMES | {"np"}
    return whole or written in listed or written.startswith("index_of(")


@pytest.mark.parametrize("file", MAY_HAVE_KERNELS, ids=name_of)
def test_kernels_make_indices_of_floats_by_the_one_helper(file: Path) -> None:
    listed = WHOLE.get(str(file.relative_to(PACKAGE)), set())
    found = [
        f"line {node.lineno}: {ast.unparse(node)}"
        for kernel in kernels(file) for node in ast.walk(kernel)
        if isinstance(node, ast.Call) and CONVERSIONS.match(ast.unparse(node.func))
        and not all(is_whole(argument, listed) for argument in node.args)
    ]
    assert found == [], "take compute.indexing.index_of, or list what is whole already"
