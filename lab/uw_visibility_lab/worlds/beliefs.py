# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Beliefs about water, scenes, cameras and ranges: distributions read from `beliefs.toml`."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from uw_visibility.errors import InputError

# Names of the two numbers of each form, as in the file.
FORMS = {
    "uniform": ("low", "high"),
    "log-uniform": ("low", "high"),
    "integer": ("low", "high"),
    "normal": ("mean", "stddev"),
    "log-normal": ("median", "stddev"),
    "share": ("share", "share"),
    "choice": ("values", "weights"),
}


@dataclass(frozen=True)
class Belief:
    """Distribution of one quantity."""

    name: str  # its key in the file, ``table.name``
    # one of `FORMS`; ``log-normal`` has the standard deviation of the natural logarithm, ``share``
    # is the probability of an event
    form: str
    # first, second: numbers of the form, in the order of `FORMS`; for a choice values and weights
    first: tuple[float, ...]
    second: tuple[float, ...]
    unit: str  # of the quantity; empty for a ratio
    source: str  # where the numbers come from

    def draw(self, rng: np.random.Generator) -> float:
        """Draw one value, in the belief's unit; for a share 1.0 or 0.0."""
        a, b = self.first[0], self.second[0]
        if self.form == "uniform":
            return a + (b - a) * rng.random()
        if self.form == "log-uniform":
            return a * (b / a) ** rng.random()
        if self.form == "integer":
            return float(rng.integers(int(a), int(b) + 1))
        if self.form == "normal":
            return a + b * rng.standard_normal()
        if self.form == "log-normal":
            return a * math.exp(b * rng.standard_normal())
        if self.form == "share":
            return float(rng.random() < a)
        total = np.cumsum(self.second)
        return self.first[int(np.searchsorted(total, rng.random() * total[-1], side="right"))]


@cache
def beliefs() -> dict[str, Belief]:
    """Read all beliefs of the shipped file, by ``table.name``."""
    text = resources.files(__package__).joinpath("beliefs.toml").read_text(encoding="utf-8")
    return parse(text)


def parse(text: str) -> dict[str, Belief]:
    """Read beliefs from a TOML text; see `beliefs`."""
    found: dict[str, Belief] = {}
    for table, entries in tomllib.loads(text).items():
        for name, entry in entries.items():
            found[f"{table}.{name}"] = _belief(f"{table}.{name}", entry)
    return found


def draw(rng: np.random.Generator, name: str) -> float:
    """Draw a value of a belief by its name."""
    return _get(name).draw(rng)


def happens(rng: np.random.Generator, name: str) -> bool:
    """Draw whether the event of a share happens."""
    return _get(name).draw(rng) > 0.0


def count(rng: np.random.Generator, name: str) -> int:
    """Draw an integer of a belief by its name."""
    return int(_get(name).draw(rng))


def bounds(name: str) -> tuple[float, float]:
    """Return the two numbers of a belief that is not a choice."""
    belief = _get(name)
    return belief.first[0], belief.second[0]


def _get(name: str) -> Belief:
    try:
        return beliefs()[name]
    except KeyError:
        raise InputError(f"no belief {name!r}: write it into beliefs.toml") from None


def _belief(name: str, entry: dict[str, Any]) -> Belief:
    for key in ("form", "unit", "source"):
        if not isinstance(entry.get(key), str):
            raise InputError(f"belief {name} has no {key}: give one as a text")
    form = entry["form"]
    if form not in FORMS:
        raise InputError(f"belief {name} has the form {form!r}: give one of {', '.join(FORMS)}")
    pair = []
    for key in FORMS[form]:
        value = entry.get(key)
        numbers = value if form == "choice" else [value]
        if not isinstance(numbers, list) or not numbers or not all(
            isinstance(number, int | float) and math.isfinite(number) for number in numbers
        ):
            raise InputError(f"belief {name} has no {key}: a {form} belief needs finite numbers")
        pair.append(tuple(float(number) for number in numbers))
    first, second = pair
    if form in ("uniform", "log-uniform", "integer") and not first[0] <= second[0]:
        raise InputError(f"belief {name} has its low end above its high one: exchange them")
    if form in ("log-uniform", "log-normal") and not first[0] > 0.0:
        raise InputError(f"belief {name} has the form {form}: give numbers above 0")
    if form == "share" and not 0.0 <= first[0] <= 1.0:
        raise InputError(f"belief {name} is a share: give a number from 0 to 1")
    if form == "choice" and (len(first) != len(second) or min(second) < 0 or sum(second) <= 0):
        raise InputError(f"belief {name} is a choice: give a weight of 0 or more for each value")
    return Belief(name, form, first, second, entry["unit"], entry["source"])
