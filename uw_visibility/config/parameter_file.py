# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameter files: the commented one of all parameters, and ones of some values.

``python -m uw_visibility.config.parameter_file PATH`` (or ``make parameters``) writes
``config/uw_visibility.yaml`` anew.
"""

from __future__ import annotations

import itertools
import sys
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from uw_visibility.config.parameters import ParameterInfo, describe
from uw_visibility.config.schema import NodeConfig, PipelineConfig

WIDTH = 100
INDENT = "  "
HEADER = """\
# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
#
# Every parameter of uw_visibility with its default, for the node
# (--ros-args --params-file) and for the command (--params-file) alike.
# Written by `make parameters` from uw_visibility/config/schema.py.

/**:
  ros__parameters:
"""


def render() -> str:
    """Return the parameter file: every parameter, its default, and its meaning as a comment."""
    lines = [HEADER.rstrip("\n")]
    for title, group in (
        ("The pipeline, of the node and of the command.", PipelineConfig),
        ("The node alone; the command accepts and ignores these.", NodeConfig),
    ):
        lines += [f"{2 * INDENT}# ---- {title}", ""]
        lines += _render_group(sorted(describe(group), key=lambda info: "." in info.name))
    return "\n".join(lines).rstrip("\n") + "\n"


def render_values(values: Mapping[str, Any], comment: str) -> str:
    """Return a parameter file with some values.

    comment: what they are, for the first lines.
    """
    nested: dict[str, Any] = {}
    for name, value in values.items():
        *sections, last = name.split(".")
        place = nested
        for section in sections:
            place = place.setdefault(section, {})
        place[last] = list(value) if isinstance(value, tuple) else value
    lines = textwrap.wrap(comment, WIDTH, initial_indent="# ", subsequent_indent="# ")
    content = {"/**": {"ros__parameters": nested}}
    return "\n".join(lines) + "\n" + yaml.safe_dump(content, default_flow_style=None)


def _render_group(infos: list[ParameterInfo]) -> Iterator[str]:
    """Yield lines for parameters that are ordered by section."""
    open_sections: list[str] = []
    for info in infos:
        *sections, name = info.name.split(".")
        pairs = zip(open_sections, sections, strict=False)
        shared = len([*itertools.takewhile(lambda pair: pair[0] == pair[1], pairs)])
        for level in range(shared, len(sections)):
            yield f"{INDENT * (2 + level)}{sections[level]}:"
        open_sections = sections
        indent = INDENT * (2 + len(sections))
        yield from textwrap.wrap(
            comment(info), WIDTH, initial_indent=indent + "# ", subsequent_indent=indent + "# ",
            break_on_hyphens=False, break_long_words=False,
        )
        # The node asks about the transfer where no file tells it.
        untold = "# " if info.name == "camera.transfer" else ""
        yield f"{indent}{untold}{name}: {_scalar(info.default)}"
        yield ""


def comment(info: ParameterInfo) -> str:
    """Return a parameter's meaning, unit, bounds and choices in a sentence or two."""
    facts = []
    if info.unit:
        facts.append(f"Unit: {info.unit}.")
    if info.minimum is not None and info.maximum is not None:
        facts.append(f"From {info.minimum:g} to {info.maximum:g}.")
    if info.choices:
        facts.append(f"One of: {', '.join(info.choices)}.")
    if info.read_only:
        facts.append("Read at start only.")
    return " ".join([info.description, *facts])


def _scalar(value: Any) -> str:
    plain = list(value) if isinstance(value, tuple) else value
    text = yaml.safe_dump(plain, default_flow_style=True, width=1000)
    return text.removesuffix("...\n").strip()


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(render(), encoding="utf-8")
