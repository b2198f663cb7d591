# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings: reading and writing bags, and replaying them through the pipeline.

    import uw_visibility.replay

    for frame in uw_visibility.replay.read("dive.mcap"):
        print(frame.stamp, frame.result.visibility.distance)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uw_visibility.replay.inputs.topics import Wanted as Wanted
    from uw_visibility.replay.library import ReplayedFrame as ReplayedFrame
    from uw_visibility.replay.library import read as read

__all__ = ["ReplayedFrame", "Wanted", "read"]


def __getattr__(name: str) -> Any:
    # Loaded on demand: writing a bag needs no pipeline.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from uw_visibility.replay import library

    return getattr(library, name)
