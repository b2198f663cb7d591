# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""YAML and JSON files: limits on size and nesting, no ambiguous content."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from uw_visibility.config.files import read_regular
from uw_visibility.errors import InputError

# Parameter files have a few kB; a bag's metadata has a few kB per topic.
MOST_BYTES = 4 << 20
DEEPEST = 32
# No parameter, size or count is larger.
LARGEST_INTEGER = 2**63
# Most characters of a number: reading takes time that grows with their square.
LONGEST_NUMBER = 100


def read_document(path: str | Path, what: str) -> Any:
    """Read a file of JSON, by its suffix, or else of YAML.

    Raises `InputError`, which names the file, if it cannot be read or parsed.
    """
    content = read_regular(path, MOST_BYTES, what)
    is_json = Path(path).suffix.lower() == ".json"
    try:
        text = content.decode("utf-8-sig")
        return parse_json(text) if is_json else parse_yaml(text)
    except ValueError as error:
        raise InputError(
            f"{what} {path} is not {'JSON' if is_json else 'YAML'} that can be used: {error}"
        ) from error


def parse_yaml(text: str) -> Any:
    """Parse YAML as ROS 2's own parser accepts it: without aliases and tags of programs.

    Raises `InputError` if it is not YAML, is nested deeper than `DEEPEST`, repeats a key, refers to
    another part of itself, or holds an integer beyond 64 bit or a number that is too long.
    """
    if text.startswith("%YAML:"):
        raise InputError(
            "it is of OpenCV's FileStorage, which other parsers do not read: write its numbers to "
            "a JSON file")
    # Imported here, since --help does not need it.
    import yaml

    parser: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        # The first pass does not recurse and limits the nesting; loading recurses.
        _check_events(yaml, yaml.parse(text, Loader=parser))
        return yaml.load(text, Loader=_loader(yaml, parser))
    except InputError:
        raise
    except yaml.YAMLError as error:
        raise InputError(" ".join(str(error).split())) from error
    except Exception as error:
        # PyYAML raises many kinds of errors for scalars that do not fit their tag.
        raise InputError(f"a value does not fit its type ({type(error).__name__})") from error


def _check_events(yaml: Any, events: Any) -> None:
    depth = 0
    for event in events:
        if isinstance(event, yaml.AliasEvent):
            raise InputError(
                f"line {event.start_mark.line + 1} refers to another part (*{event.anchor}): "
                "write the values out"
            )
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise InputError(f"it is nested deeper than {DEEPEST} levels")


def _loader(yaml: Any, parser: Any) -> Any:
    """Return a YAML loader that refuses repeated keys and long numbers."""

    class Loader(parser):  # type: ignore[misc]
        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            _check_unique(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
            return super().construct_mapping(node, deep)

        def construct_scalar(self, node: Any) -> Any:
            if node.tag.endswith((":int", ":float")):
                _check_length(node.value)
            return super().construct_scalar(node)

        def construct_yaml_int(self, node: Any) -> int:
            return _check_integer(super().construct_yaml_int(node))

    Loader.add_constructor("tag:yaml.org,2002:int", Loader.construct_yaml_int)
    return Loader


def parse_json(text: str) -> Any:
    """Parse JSON.

    Raises `InputError` if it is not JSON (NaN and Infinity are not), is nested too deep, repeats a
    key, or holds an integer beyond 64 bit.
    """
    try:
        return json.loads(
            text, object_pairs_hook=_unique, parse_int=_integer, parse_constant=_refuse
        )
    except RecursionError as error:
        raise InputError("it is nested too deep") from error
    except ValueError as error:
        raise InputError(str(error)) from error


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    _check_unique(name for name, _ in pairs)
    return dict(pairs)


def _integer(text: str) -> int:
    _check_length(text)
    return _check_integer(int(text))


def _check_integer(value: int) -> int:
    if not -LARGEST_INTEGER <= value < LARGEST_INTEGER:
        raise InputError(f"it has the integer {value}: give one of 64 bit")
    return value


def _check_unique(names: Iterable[str]) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError(f"it gives {name!r} twice in one place: remove one of them")


def _check_length(number: str) -> None:
    if len(number) > LONGEST_NUMBER:
        raise InputError(f"it has a number of {len(number)} characters")


def _refuse(word: str) -> None:
    raise InputError(f"it has {word}, which is not a number in JSON")
