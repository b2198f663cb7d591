# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The saved Foxglove layout shows topics that exist."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.outputs import all_topics

FILE = Path(__file__).resolve().parents[1] / "foxglove" / "uw_visibility.json"
INPUTS = {"left/image_rect", "left/camera_info", "depth_sensor"}
OTHERS = {"depth_plausibility/nis", "diagnostics"}


def strings(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        value = [*value, *value.values()]
    if isinstance(value, list):
        for item in value:
            yield from strings(item)
    elif isinstance(value, str):
        yield value


def test_layout_shows_topics_that_exist() -> None:
    layout = json.loads(FILE.read_text(encoding="utf-8"))
    topics = set(all_topics(NodeConfig(publish_depth_image=True, publish_points=True)))
    shown = {
        re.match(r"/([^.]+)", text)[1]  # type: ignore[index]
        for text in strings(layout["configById"]) if text.startswith("/")
    }
    assert shown <= topics | INPUTS | OTHERS
    assert len(shown) > 10


def test_every_panel_has_its_place() -> None:
    layout = json.loads(FILE.read_text(encoding="utf-8"))
    panels = {text for text in strings(layout["layout"]) if "!" in text}
    assert panels == set(layout["configById"])
