# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of cases, for the experiments and the survey under lamps."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from uw_visibility.status import Status
from uw_visibility_lab.evaluation.readings import Reading, Truth
from uw_visibility_lab.evaluation.tables import as_text, flat, number, percent

if TYPE_CHECKING:
    from uw_visibility_lab.evaluation.cases import CaseResult

OK = str(Status.OK)
SIGMAS = 3.0
"""An error beyond that many standard deviations is wrong."""
TOO_LONG = 1.2
"""A visibility beyond that part of the true one is too long."""
NEAR = 0.2
"""Relative error of visibility up to which it is right."""

COLUMNS = {
    "cases": "cases", "refused": "refused", "refused_depth": "no depth", "right": "right",
    "beyond.attenuation": "> 3 σ: β", "beyond.visibility": "visib.", "beyond.depth": "depth",
    "beyond_any": "any", "too_long": "long", "visibility_relative_stddev": "σ", "ratio": "ratio",
    "mean_attenuation_error": "|α̂ − α|", "mean_attenuation_worst": "worst",
}
"""Headings of tables of statistics, by the statistic's dotted name."""
DIGITS = {"ratio": 2, "mean_attenuation_error": 4, "mean_attenuation_worst": 4}
"""Decimals of what is no share."""
LEGEND = (
    "shares of all cases in %; right: visibility within 20 %; > 3 σ: published and farther from\n"
    "the truth; long: visibility beyond 1.2 times the true one; σ: median of visibility's, in %;\n"
    "ratio: median of published over true visibility; |α̂ − α|: mean and worst, 1/m")

Summary = dict[str, Any]
Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Return items by a key of each, in the order of its first."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def statistics(pairs: Sequence[tuple[Truth, Reading]]) -> Summary:
    """Error, σ, refusals and what is wrong, over one or more cases.

    Shares are of all cases, refused ones among them. ``refused``: no visibility distance.
    ``right``: visibility within `NEAR`. ``beyond``: published, and farther from the truth than
    3 σ; of β where any channel is. ``ratio``: median of published over true visibility.
    ``too_long``: beyond 1.2 times the true one. Errors are means of the absolute, NaN where nothing
    was published.
    """
    beyond = {
        "attenuation": [any(_channels_beyond(truth, reading)) for truth, reading in pairs],
        "visibility": [
            _beyond(r.distance, t.distance, r.distance_stddev) for t, r in pairs],
        "depth": [_beyond(r.depth, t.depth, r.depth_stddev) for t, r in pairs],
    }
    ratios = [reading.distance / truth.distance for truth, reading in pairs]
    errors = _known(abs(r.mean_attenuation - t.mean_attenuation) for t, r in pairs)
    return {
        "cases": len(pairs),
        "refused": _share(not math.isfinite(ratio) for ratio in ratios),
        "refused_depth": _share(not math.isfinite(reading.depth) for _, reading in pairs),
        "right": _share(abs(ratio - 1.0) <= NEAR for ratio in ratios),
        "reasons": _reasons(pairs, lambda reading: (reading.status, reading.distance_status)),
        "reasons_depth": _reasons(pairs, lambda reading: (reading.status, reading.depth_status)),
        "mean_attenuation_error": mean(errors),
        "mean_attenuation_worst": max(errors, default=math.nan),
        "attenuation_error": mean(
            abs(found - true)
            for truth, reading in pairs
            for found, true in zip(reading.attenuation, truth.attenuation, strict=True)
        ),
        "attenuation_stddev": mean(
            s for _, reading in pairs for s in reading.attenuation_stddev),
        "depth_error": mean(abs(reading.depth - truth.depth) for truth, reading in pairs),
        "depth_stddev": mean(reading.depth_stddev for _, reading in pairs),
        "ratio": _median(ratios),
        "visibility_relative_stddev": _median(
            reading.distance_stddev / reading.distance for _, reading in pairs),
        "too_long": _share(ratio > TOO_LONG for ratio in ratios),
        "beyond": {name: _share(wrong) for name, wrong in beyond.items()},
        "beyond_any": _share(any(wrong) for wrong in zip(*beyond.values(), strict=True)),
    }


def by_estimate(results: Sequence[CaseResult]) -> dict[str, Summary]:
    """Return statistics of cases by the names of their readings; empty without any."""
    names = results[0].readings if results else {}
    return {name: statistics([(r.truth, r.readings[name]) for r in results]) for name in names}


def mean(values: Iterable[float]) -> float:
    """Return the mean of those that are known; NaN of none."""
    known = _known(values)
    return float(np.mean(known)) if known else math.nan


def _known(values: Iterable[float]) -> list[float]:
    return [value for value in values if math.isfinite(value)]


def _median(values: Iterable[float]) -> float:
    known = _known(values)
    return float(np.median(known)) if known else math.nan


def _share(flags: Iterable[bool]) -> float:
    return float(np.mean(list(flags)))


def _channels_beyond(truth: Truth, reading: Reading) -> list[bool]:
    return [
        _beyond(found, true, stddev)
        for found, true, stddev in zip(
            reading.attenuation, truth.attenuation, reading.attenuation_stddev, strict=True)
    ]


def _beyond(found: float, true: float, stddev: float) -> bool:
    """Tell whether a published value is wrong; one without σ is wrong unless it is exact."""
    if not math.isfinite(found):
        return False
    return not abs(found - true) <= SIGMAS * stddev


def _reasons(
    pairs: Sequence[tuple[Truth, Reading]], statuses: Callable[[Reading], tuple[str, str]]
) -> dict[str, int]:
    """Count the first status of each reading that is not ok, most frequent first."""
    counts = Counter(
        next((status for status in statuses(reading) if status != OK), OK)
        for _, reading in pairs
    )
    return {reason: n for reason, n in counts.most_common() if reason != OK}


def statistics_text(title: str, found: Iterable[tuple[str, Summary]]) -> str:
    """Return statistics of groups of cases as a table; shares in percent."""
    def shown(name: str, value: float) -> str:
        if name == "cases":
            return str(value)
        return number(value, DIGITS[name]) if name in DIGITS else percent(value)

    rows = [(group, flat(statistic)) for group, statistic in found]
    return as_text([title, *COLUMNS.values()], [
        [group, *(shown(name, values[name]) for name in COLUMNS)] for group, values in rows])


def reasons_text(found: Summary, group: str = "refused") -> list[str]:
    """Tell why the cases of a group were refused, in one line; none where none was."""
    # The advice after a reason is in evaluation.json.
    told = "; ".join(f"{reason.split(' (')[0]}: {n}" for reason, n in found["reasons"].items())
    return [f"  {group}: {told}"] if told else []
