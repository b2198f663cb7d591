# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Summary statistics of the adverse study: error, σ, refusals, and estimates beyond 3 σ."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from uw_visibility.evaluation.adverse.cases import METHODS, AdverseResult
from uw_visibility.evaluation.adverse.effects import CONTROL
from uw_visibility.evaluation.readings import Reading, Truth
from uw_visibility.status import Status

SIGMAS = 3.0
"""An error beyond that many standard deviations is wrong."""
TOO_LONG = 1.2
"""A visibility beyond that part of the true one is too long."""
CERTAIN = 0.15
"""A relative standard deviation of visibility up to which it says much."""

OK = str(Status.OK)
Summary = dict[str, Any]


def summarise_adverse(results: Sequence[AdverseResult]) -> Summary:
    """Reduce a study to its summary.

    Returns
    -------
    dict
        ``effects``: by effect, then by the names of `METHODS`; ``levels``: the same
        by effect and level; ``adverse``: over all cases but the control's;
        ``control``: over the control's, with and without open water in view.
    """
    names = list(dict.fromkeys(result.effect for result in results))
    adverse = [result for result in results if result.effect != CONTROL]
    control = [result for result in results if result.effect == CONTROL]
    return {
        "cases": len(results),
        "scenes": list(dict.fromkeys(result.scene for result in results)),
        "effects": {
            name: by_method([r for r in results if r.effect == name]) for name in names
        },
        "levels": {
            name: {
                level: by_method([r for r in results if (r.effect, r.level) == (name, level)])
                for level in dict.fromkeys(r.level for r in results if r.effect == name)
            }
            for name in names
        },
        "adverse": by_method(adverse),
        "control": {
            "open_water": by_method([r for r in control if r.open_water]),
            "no_open_water": by_method([r for r in control if not r.open_water]),
        },
    }


def by_method(results: Sequence[AdverseResult]) -> dict[str, Summary]:
    """Return `statistics` of the results by the names of `METHODS`; empty without any."""
    if not results:
        return {}
    return {name: statistics([(r.truth, r.readings[name]) for r in results]) for name in METHODS}


def statistics(pairs: Sequence[tuple[Truth, Reading]]) -> Summary:
    """Error, σ, refusals and what is wrong, over cases.

    Parameters
    ----------
    pairs : sequence of (Truth, Reading)
        Cases; one or more.

    Returns
    -------
    dict
        Shares are of all cases, refused ones among them. ``refused``: no visibility
        distance. ``beyond``: published, and farther from the truth than 3 σ; of β where any
        channel is. ``ratio``: median of published over true visibility.
        ``too_long``: beyond 1.2 times the true one. Errors are means of the absolute,
        NaN where nothing was published.
    """
    count = len(pairs)
    beyond = {
        "attenuation": [any(_channels_beyond(truth, reading)) for truth, reading in pairs],
        "visibility": [
            _beyond(r.distance, t.distance, r.distance_stddev) for t, r in pairs],
        "depth": [_beyond(r.depth, t.depth, r.depth_stddev) for t, r in pairs],
    }
    ratios = [reading.distance / truth.distance for truth, reading in pairs]
    return {
        "cases": count,
        "refused": _share(not math.isfinite(reading.distance) for _, reading in pairs),
        "refused_depth": _share(not math.isfinite(reading.depth) for _, reading in pairs),
        "reasons": _reasons(pairs, lambda reading: (reading.status, reading.distance_status)),
        "reasons_depth": _reasons(pairs, lambda reading: (reading.status, reading.depth_status)),
        "attenuation_error": _mean(
            abs(found - true)
            for truth, reading in pairs
            for found, true in zip(reading.attenuation, truth.attenuation, strict=True)
        ),
        "attenuation_stddev": _mean(
            s for _, reading in pairs for s in reading.attenuation_stddev),
        "depth_error": _mean(abs(reading.depth - truth.depth) for truth, reading in pairs),
        "depth_stddev": _mean(reading.depth_stddev for _, reading in pairs),
        "ratio": _median(ratios),
        "visibility_relative_stddev": _median(
            reading.distance_stddev / reading.distance for _, reading in pairs),
        "certain": _share(
            reading.distance_stddev <= CERTAIN * reading.distance for _, reading in pairs),
        "too_long": _share(ratio > TOO_LONG for ratio in ratios),
        "beyond": {name: _share(wrong) for name, wrong in beyond.items()},
        "beyond_any": _share(any(wrong) for wrong in zip(*beyond.values(), strict=True)),
    }


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


def _share(flags: Iterable[bool]) -> float:
    return float(np.mean(list(flags)))


def _mean(values: Iterable[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return float(np.mean(known)) if known else math.nan


def _median(values: Iterable[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return float(np.median(known)) if known else math.nan
