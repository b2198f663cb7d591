# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Options of sub-commands as tables of names, defaults and help."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, TypeAlias

Options: TypeAlias = Mapping[str, tuple[Any, ...]]
"""Default and help by option name and metavars.

The default tells the type, float without one, unless it is given behind the help. Braces hold
choices, dots stand for one value or more.
"""


def add_described(parser: argparse._ActionsContainer, options: Options) -> None:
    """Add options to a parser, or to a group of one; help ends with the default."""
    for named, (default, text, *kind) in options.items():
        name, *values = named.split()
        if default is False:
            parser.add_argument(name, action="store_true", help=text)
            continue
        shown = default if isinstance(default, tuple | list) else (default,)
        told = default in (None, []) or text.endswith(")")
        how: dict[str, Any] = {"metavar": values[0]}
        if values[-1] == "...":
            how["nargs"] = "+"
        elif len(values) > 1:
            how |= {"nargs": len(values), "metavar": tuple(values)}
        elif values[0].startswith("{"):
            how = {"choices": values[0].strip("{}").split(",")}
        parser.add_argument(
            name, default=default, type=kind[0] if kind else _kind(shown[0]),
            help=text if told else f"{text} ({' '.join(map(_shown, shown))})", **how,
        )


def _kind(value: Any) -> type:
    return float if value is None else type(value)


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:g}"
