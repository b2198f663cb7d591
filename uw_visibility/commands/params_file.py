# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Options of commands: described ones, and ``--params-file``, the node's parameter file."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from uw_visibility.errors import InputError

Made = TypeVar("Made")
Options: TypeAlias = Mapping[str, tuple[Any, ...]]
"""Default and help, by an option's name and what stands for its values.

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


def of_arguments(
    kind: Callable[..., Made], arguments: argparse.Namespace, **others: Any
) -> Made:
    """Make a dataclass of the arguments that are named as its fields, and of others."""
    given = {
        field.name: getattr(arguments, field.name) for field in fields(kind)  # type: ignore[arg-type]
        if field.name not in others and hasattr(arguments, field.name)
    }
    values = {
        name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}
    return kind(**values, **others)


def read_params_file(path: Path | None) -> dict[str, Any]:
    """Read a parameter file, of which `PipelineConfig` and `NodeConfig` take what is theirs.

    Parameters
    ----------
    path : Path or None
        The file; None gives no values.

    Returns
    -------
    dict of str to object
        Values by dotted name, each known and allowed.

    Raises
    ------
    InputError
        If the file cannot be read, or a parameter is unknown or not allowed;
        names the file.
    """
    from uw_visibility.config.schema import NodeConfig, PipelineConfig, read_yaml

    values: dict[str, Any] = {} if path is None else read_yaml(path)
    try:
        NodeConfig.from_parameters(values)
        PipelineConfig.from_parameters(values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return values
