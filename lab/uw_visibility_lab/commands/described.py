# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Options of sub-commands as tables of names, defaults and help."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, TypeAlias

Options: TypeAlias = Mapping[str, Any]
"""Default and help by option names and metavars; or such a table by the title of a group.

The type is that of the default (float for None), unless it is given after the help. Braces enclose
choices; dots mean one or more values.
"""

REQUIRED: Any = object()
"""Instead of a default: the option must be given."""


def add_described(parser: argparse._ActionsContainer, options: Options) -> None:
    """Add options and groups of options to a parser; the default is appended to the help."""
    for named, described in options.items():
        if isinstance(described, Mapping):
            add_described(parser.add_argument_group(named), described)
            continue
        default, text, *kind = described
        names = [word for word in named.split() if word.startswith("-")]
        values = named.split()[len(names):]
        if default is False:
            parser.add_argument(*names, action="store_true", help=text)
            continue
        how: dict[str, Any] = {"metavar": values[0], "default": default}
        if default is REQUIRED:
            default, how = None, {"metavar": values[0], "required": True}
        if values[-1] == "...":
            how["nargs"] = "+"
        elif len(values) > 1:
            how |= {"nargs": len(values), "metavar": tuple(values)}
        elif values[0].startswith("{"):
            how = {"choices": values[0].strip("{}").split(","), "default": default}
        shown = default if isinstance(default, tuple | list) else (default,)
        complete = default in (None, []) or text.endswith(")")
        parser.add_argument(
            *names, type=kind[0] if kind else _kind(shown[0]),
            help=text if complete else f"{text} ({' '.join(map(_shown, shown))})", **how,
        )


def _kind(value: Any) -> type:
    return float if value is None else type(value)


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)
