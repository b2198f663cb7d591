# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Described parameters: dataclass fields with unit, bounds and description."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from uw_visibility.config.documents import read_document
from uw_visibility.errors import InputError, naming

# Parameters of every ROS 2 node, which a dump of a node holds too.
ROS_PARAMETERS = ("qos_overrides.", "start_type_description_service", "use_sim_time")


@dataclasses.dataclass(frozen=True)
class ParameterInfo:
    """Description, unit, bounds and choices of a parameter."""

    name: str  # dotted name, as in the YAML file and on the node
    type: type  # one of bool, int, float, str, or tuple for a list of floats
    default: Any  # value if none is given
    description: str  # one sentence
    unit: str = ""  # "" for none
    # minimum, maximum: inclusive bounds of a number
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()  # the allowed words, or () for any
    read_only: bool = False  # whether a change needs a restart of the node
    repeats: bool = False  # whether a list's length may be a multiple of the default's

    def check(self, value: Any) -> Any:
        """Return a value in the parameter's type; refuse one whose type or bounds do not fit."""
        value = self._of_type(value)
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        for number in {tuple: value, int: (value,), float: (value,)}.get(self.type, ()):
            if not low <= number <= high:
                raise InputError(
                    f"parameter {self.name} is {number!r}: give a value between {low:g} and "
                    f"{high:g}{' ' + self.unit if self.unit else ''}"
                )
        if self.choices and value not in self.choices:
            raise InputError(
                f"parameter {self.name} is {value!r}: give one of {', '.join(self.choices)}"
            )
        return value

    def numeric(self, value: Any) -> Any:
        """Convert text and integers to floats where the parameter is a float or a list.

        ``ros2 param`` reads 5 as an integer and, by YAML 1.1, 1e-05 as a text, so that its own
        dumps would not load. rclpy gives lists of numbers as a typed array.
        """
        try:
            if self.type is float and _is_number(value):
                return float(value)
            if self.type is tuple and not isinstance(value, bytes):
                parts = value.strip("[] ").split(",") if isinstance(value, str) else [*value]
                if all(map(_is_number, parts)):
                    return [float(each) for each in parts]
        except (OverflowError, TypeError, ValueError):
            # `check` reports the error.
            pass
        return value

    def _of_type(self, value: Any) -> Any:
        value = self.numeric(value)
        if self.type is tuple:
            numbers = isinstance(value, list) and all(isinstance(each, float) for each in value)
            times, rest = divmod(len(value), len(self.default)) if numbers else (0, 0)
            if not times or rest or (times > 1 and not self.repeats):
                wanted = f"{len(self.default)} number{'s' if len(self.default) > 1 else ''}"
                wanted += " for each, one after the other" if self.repeats else ""
                raise InputError(f"parameter {self.name} is {value!r}: give {wanted}")
            return tuple(value)
        if type(value) is not self.type:
            raise InputError(
                f"parameter {self.name} is {value!r} of type {type(value).__name__}: "
                f"give a value of type {self.type.__name__}"
            )
        return value


def parameter(default: Any, description: str, **facts: Any) -> Any:
    """Declare a described parameter as a dataclass field.

    **facts: unit, bounds and other fields of `ParameterInfo`.
    """
    return dataclasses.field(default=default, metadata={"description": description, **facts})


def section(group: type) -> Any:
    """Declare a nested group of parameters with its defaults."""
    return dataclasses.field(default_factory=group)


# Cached: a node checks all its parameters each time that it declares one.
@functools.cache
def describe(group: type, prefix: str = "") -> tuple[ParameterInfo, ...]:
    """Return every parameter of a dataclass and of its sections, in order."""
    infos: list[ParameterInfo] = []
    for field in dataclasses.fields(group):
        name, inner = prefix + field.name, _group_of(field)
        if inner is None:
            infos.append(ParameterInfo(name, type(field.default), field.default, **field.metadata))
        else:
            infos += describe(inner, f"{name}.")
    return tuple(infos)


def _group_of(field: Any) -> Any:
    """Return the group of a field made by `section`; None for one made by `parameter`."""
    return None if field.default_factory is dataclasses.MISSING else field.default_factory


def build(group: type, values: Mapping[str, Any], prefix: str = "") -> Any:
    """Make a dataclass of parameters from values by dotted name.

    Absent ones keep their defaults, and unknown names are ignored (see `check_names`).
    """
    infos = {info.name: info for info in describe(group, prefix)}
    arguments = {}
    for field in dataclasses.fields(group):
        name, inner = prefix + field.name, _group_of(field)
        if inner is not None:
            arguments[field.name] = build(inner, values, name + ".")
        elif name in values:
            arguments[field.name] = infos[name].check(values[name])
    return group(**arguments)


def check_names(given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse unknown names, and suggest the nearest known one."""
    names = set(known)
    for name in given:
        if name not in names:
            near = difflib.get_close_matches(name, sorted(names), n=1, cutoff=0.0)
            raise InputError(f"unknown parameter {name}: did you mean {near[0]}?")


def flatten(values: Any, prefix: str = "") -> dict[str, Any]:
    """Return a dataclass, or nested mappings, as one mapping by dotted name.

    Raises `InputError` if a name appears twice, once nested and once with dots.
    """
    if dataclasses.is_dataclass(values):
        values = {f.name: getattr(values, f.name) for f in dataclasses.fields(values)}
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if dataclasses.is_dataclass(value) or isinstance(value, Mapping):
            inside = flatten(value, f"{prefix}{name}.")
        else:
            inside = {f"{prefix}{name}": value}
        twice = sorted(inside.keys() & flat.keys())
        if twice:
            raise InputError(f"parameter {twice[0]} is given twice: remove one of them")
        flat.update(inside)
    return flat


def read_yaml(path: str | Path, node: str | None = None) -> dict[str, Any]:
    """Read a ROS 2 parameter file as values by dotted name.

    The form is that of ``ros2 param dump``: a node's name (or ``/**``), optionally below
    namespaces, then ``ros__parameters``, then the values, nested or with dots.

    node: full name of a node, such as ``/auv/uw_visibility``; only its values are returned.
    Raises `InputError` if the file cannot be read or has another form.
    """
    values: dict[str, Any] = {}
    for name, parameters in _node_blocks(read_document(path, "parameter file"), "", path):
        if node is not None and not _names(name, node):
            continue
        with naming(f"parameter file {path}"):
            values.update(flatten(parameters))
    return {k: v for k, v in values.items() if not k.startswith(ROS_PARAMETERS)}


def render_values(values: Mapping[str, Any], comment: str) -> str:
    """Return a parameter file with some values, and a comment in its first lines."""
    # Imported here, since --help does not need it.
    import yaml

    nested: dict[str, Any] = {}
    for name, value in values.items():
        *sections, last = name.split(".")
        place = nested
        for section in sections:
            place = place.setdefault(section, {})
        place[last] = list(value) if isinstance(value, tuple) else value
    lines = textwrap.wrap(comment, 100, initial_indent="# ", subsequent_indent="# ")
    content = {"/**": {"ros__parameters": nested}}
    return "\n".join(lines) + "\n" + yaml.safe_dump(content, default_flow_style=None)


def _node_blocks(
    content: Any, namespace: str, path: str | Path
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the parameters of each node name or pattern in a file."""
    if not isinstance(content, dict) or not content:
        raise InputError(
            f"parameter file {path} has no 'ros__parameters' under a node's name: "
            "see config/uw_visibility.yaml for the form"
        )
    for key, block in content.items():
        name = f"{namespace}/{str(key).strip('/')}"
        if isinstance(block, dict) and isinstance(block.get("ros__parameters"), dict):
            yield name, block["ros__parameters"]
        else:
            yield from _node_blocks(block, name, path)


def _names(pattern: str, node: str) -> bool:
    """Return whether a name in a parameter file matches a node: * is any part, ** any parts."""
    parts = "".join(
        "(/[^/]+)*" if part == "**" else "/" + re.escape(part).replace(r"\*", "[^/]*")
        for part in pattern.strip("/").split("/")
    )
    return re.fullmatch(parts, node) is not None


def _is_number(value: Any) -> bool:
    """Return whether a value is a number, or text that may be one."""
    return isinstance(value, int | float | str) and not isinstance(value, bool)
