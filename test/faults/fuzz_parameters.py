# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters that change while a node runs: what is accepted works, what cannot is refused."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import live
from fuzz import Outcome
from fuzz_messages import Wire

NUMBERS = (0.0, -1.0, 1e-300, 1e300, math.nan, math.inf, -math.inf, 0.5, 3.0)
WHOLE = (0, -1, 1, 7, 255, 65_536, 2**31, -(2**63), 2**63 - 1)
TEXTS = (
    "", " ", "none", "map", "/dev/zero", "/dev/null", "/none.png", "/", "../x", "\x1b[2J\n",
    "x" * 100_000, "é\u202e", "nan",
)


class Cases:
    """Changes of one to three parameters of a node with images."""

    case = ""

    def __init__(self, folder: Path) -> None:
        from uw_visibility.config.parameters import describe
        from uw_visibility.config.schema import NodeConfig, PipelineConfig

        parts = live.load()
        self._wire = Wire(folder, "changed")
        scene = parts.make_scene()
        self._frame = {}
        for side, pixels in zip(live.SIDES, (scene.left, scene.right), strict=True):
            self._frame[f"{side}/camera_info"] = parts.info_message(side)
            self._frame[f"{side}/image"] = parts.image_message(pixels, "rgb8")
        self._infos = [*describe(PipelineConfig), *describe(NodeConfig)]
        self._wire.answered(self._frame, 100)

    def run(self, seed: int) -> Outcome:
        """Change parameters, look whether frames are answered, and change them back."""
        rng = random.Random(seed)
        infos = rng.sample(self._infos, rng.choice((1, 1, 2, 3)))
        changes = {info.name: _value(info, rng) for info in infos}
        self.case = ", ".join(f"{name} = {str(value)[:30]!r}" for name, value in changes.items())
        accepted, reason = self._set(changes)
        try:
            self._wire.answered(self._frame)
            self._wire.counts()
        except AssertionError as error:
            return Outcome(self.case, "stops", f"{accepted} {reason} {error}"[-3000:])
        finally:
            # One at least, since rclpy refuses a list of none.
            default = {i.name: i.default for i in infos if not i.read_only}
            back, why = self._set(default | {"stereo.max_disparity": 40})
        if not back:
            return Outcome(self.case, "no way back", why)
        if not accepted and not (reason and reason.isprintable()):
            return Outcome(self.case, "no reason", repr(reason))
        return Outcome(self.case, "read" if accepted else "refused", reason)

    def close(self) -> None:
        """End the node."""
        self._wire.close()

    def _set(self, values: dict[str, Any]) -> tuple[bool, str]:
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        parameters = [
            Parameter(name, value=list(value) if isinstance(value, tuple) else value)
            .to_parameter_msg() for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=parameters)
        result = self._wire.client.call(
            "uw_visibility/set_parameters_atomically", request).result
        return bool(result.successful), str(result.reason)


def _value(info: Any, rng: random.Random) -> Any:
    """Return a value for a parameter: of its type mostly, allowed or not."""
    kind = info.type
    if rng.random() < 0.05:
        kind = rng.choice((bool, int, float, str, tuple))
    low, high = info.minimum, info.maximum
    if kind is bool:
        return rng.random() < 0.5
    if kind is str:
        return rng.choice((*info.choices, *TEXTS) if rng.random() < 0.5 else TEXTS)
    bounded = low is not None and high is not None
    if kind is int:
        if bounded and rng.random() < 0.6:
            return rng.choice((int(low), int(high), rng.randint(int(low), int(high))))
        return rng.choice(WHOLE)
    if kind is float:
        if bounded and rng.random() < 0.6:
            return rng.choice((float(low), float(high), rng.uniform(low, high)))
        return rng.choice(NUMBERS)
    return [rng.choice(NUMBERS) for _ in range(rng.choice((0, 1, 3, 3, 3, 1000)))]
