# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Degenerate pairs to a real node: each is answered, or refused with a reason."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import live
from fuzz import Outcome
from fuzz_messages import TRIES, Wire
from fuzz_pictures import Picture

# Each size is allocated for anew.
LONGEST_ANSWER = 20.0


class Cases:
    """One node, to which warnings of numpy are errors."""

    case = ""

    def __init__(self, folder: Path) -> None:
        self._parts = live.load()
        self._wire = Wire(folder, "pairs")

    def run(self, seed: int) -> Outcome:
        """Send a pair, and hold the node to what it says of it."""
        picture = Picture.random(seed)
        self.case = str(picture)
        before = self._wire.counts()
        frame = self._frame(picture)
        for _ in range(TRIES):
            stamp = self._wire.stamped(frame)
            self._wire.send(frame)
            end = time.monotonic() + LONGEST_ANSWER / TRIES
            while time.monotonic() < end:
                if self._wire.client.has("disparity", stamp):
                    return Outcome(self.case, "read")
                after = self._wire.counts()
                if after.refused > before.refused:
                    named = [name for name, _ in after.reasons - before.reasons]
                    return Outcome(self.case, "refused" if named else "no reason", str(named))
        return Outcome(self.case, "no answer", self._wire.node.log[-2000:])

    def close(self) -> None:
        """End the node; raises where it does not end well."""
        self._wire.close()

    def _frame(self, picture: Picture) -> dict[str, Any]:
        left, right, _ = picture.make()
        encoding = f"{'mono' if picture.grey else 'rgb'}{picture.bits}"
        frame: dict[str, Any] = {}
        for side, pixels in (("left", left), ("right", right)):
            frame[f"{side}/image"] = self._parts.image_message(pixels, encoding)
            frame[f"{side}/camera_info"] = self._info(side, picture)
        return frame

    def _info(self, side: str, picture: Picture) -> Any:
        focal, baseline = picture.rig.focal_length, picture.rig.baseline
        cx, cy = picture.rig.principal_point
        shift = -focal * baseline if side == "right" else 0.0
        return self._parts.info_message(
            side, width=picture.width, height=picture.height,
            k=[focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0],
            p=[focal, 0.0, cx, shift, 0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0])
