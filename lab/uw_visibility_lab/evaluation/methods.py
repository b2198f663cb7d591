# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Methods of one's own beside ours and the peers, by entry point.

A package that is installed beside this one names them in the group
``uw_visibility.methods``; `evaluate` then shows them in tables and figures:

    # of its setup.py
    entry_points={"uw_visibility.methods": ["mine = my_package:match"]}

    # my_package.py
    @method("matcher", "my matcher")
    def match(left, right, max_disparity):
        return disparity        # (H, W) float32, px; NaN where unmatched
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.metadata import entry_points
from typing import Any, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility_lab.evaluation import mccnn

GROUP = "uw_visibility.methods"
Kind = Literal["matcher", "estimator", "restorer"]
Function = TypeVar("Function", bound=Callable[..., Any])


class Method(NamedTuple):
    """A method to compare with."""

    # ``"matcher"``, called with the pair ((H, W, 3) uint8 each) and the largest disparity, returns
    # the left disparity, (H, W) float32, px, NaN where unmatched; ``"estimator"``, called with the
    # left image, its ranges ((H, W) float32, m) and the transfer, returns a `WaterEstimate`;
    # ``"restorer"``, called with the left image and its ranges, NaN where unknown, returns the
    # image without the water, uint8
    kind: str
    title: str  # for tables and figures
    run: Callable[..., Any]

    def image(self, *arguments: Any, dtype: type) -> NDArray[Any]:
        """Call a matcher or a restorer; what it returns has the size of the left image."""
        found: NDArray[Any] = np.asarray(self.run(*arguments), dtype)
        expected = arguments[0].shape if self.kind == "restorer" else arguments[0].shape[:2]
        if found.shape != expected:
            raise InputError(
                f"{self.kind} {self.title!r} returns the shape {found.shape}: return {expected}")
        return found


def method(kind: Kind, title: str) -> Callable[[Function], Function]:
    """Mark a function as a method to compare with; see `Method`."""

    def mark(function: Function) -> Function:
        function.uw_visibility_method = (kind, title)  # type: ignore[attr-defined]
        return function

    return mark


@cache
def own_methods() -> dict[str, Method]:
    """Return MC-CNN, where it is installed, and methods by the names of their entry points."""
    found = {} if mccnn.missing() else {"mccnn": Method("matcher", mccnn.TITLE, mccnn.match)}
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        try:
            function = entry.load()
        except Exception as error:  # whatever that package does when it is imported
            raise InputError(
                f"method {entry.name} of {GROUP} cannot be loaded from {entry.value}: {error}"
            ) from error
        kind, title = getattr(function, "uw_visibility_method", ("", ""))
        if kind not in get_args(Kind):
            raise InputError(
                f"method {entry.name} of {GROUP} is not marked as one: put "
                f"@method(\"{'|'.join(get_args(Kind))}\", title) before {entry.value}"
            )
        found[entry.name] = Method(kind, title, function)
    return found


def of_kind(kind: Kind) -> dict[str, Method]:
    """Return the methods of a kind, by name."""
    return {name: each for name, each in own_methods().items() if each.kind == kind}


def titles(kind: Kind, taken: dict[str, str]) -> dict[str, str]:
    """Return names and titles of a kind, of methods there already and of one's own."""
    own = {name: each.title for name, each in of_kind(kind).items()}
    for name in own.keys() & taken.keys():
        raise InputError(f"method {name} of {GROUP} has a name that is taken: give another one")
    return taken | own
