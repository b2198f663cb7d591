# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameter files with some values; ``tools/write_parameters`` writes the complete one."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

import yaml

WIDTH = 100


def render_values(values: Mapping[str, Any], comment: str) -> str:
    """Return a parameter file with some values.

    comment: text of the first lines.
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
