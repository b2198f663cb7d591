# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Synopsis of a replay: times, ranges, visibility, and its trend or jumps."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import scipy.stats
from scipy.special import logsumexp, softmax

from uw_visibility.images.arrays import Array
from uw_visibility.replay.columns import CHANNELS, TRANSECT, word
from uw_visibility.replay.line_fit import JACKKNIFE_BLOCKS
from uw_visibility.replay.table import Columns
from uw_visibility.water.meaning.derived import DerivedQuantities
from uw_visibility.water.series.tracking import TrackingEvent

# Distances that differ by more than this many standard deviations are different.
SIGNIFICANT = 2.0
# Probability of a rise or fall by chance below which it is a trend.
BY_CHANCE = 0.05
# Main quantities of a verdict, in order.
TOLD = ("black_disc_visibility", "visibility_distance", "secchi_depth", "diffuse_attenuation_490")
# Least number of values for a trend: four rise or fall by chance too often (2 of 24 orders).
FEWEST = 5
# Least relative width of a group: that of values with three digits.
NARROWEST = 1e-3
# Conditions for two groups: strong evidence (Kass and Raftery 1995,
# doi:10.1080/01621459.1995.10476572), and least distance of their means in standard deviations of
# a group (Ashman, Bird and Zepf 1994, doi:10.1086/117248).
EVIDENCE, SEPARATION = 6.0, 2.0
# Iterations of the fit of two groups.
STEPS = 200
# A step between stamps longer than this many median steps is a gap.
LONGEST_STEP = 3.0


@dataclass(frozen=True)
class Extreme:
    """Smallest or largest visibility distance of a recording."""

    transect: str  # recording of the frame, with several recordings; else empty
    frame: int  # number of the frame
    # value, stddev: m
    value: float
    stddev: float


@dataclass(frozen=True)
class Synopsis:
    """Visibility over a whole recording."""

    frames: int  # number of all frames
    # start, end: first and last stamp, ns
    start: int
    end: int
    assessed: int  # frames with a visibility distance of their own
    told: int  # frames with a distance: the filtered one if `filtered`, else their own
    filtered: bool  # whether the distances below are the filtered ones
    contrast: float  # least visible contrast, for which visibility distance is defined
    # nearest and farthest range used by the estimates, m; empty without any
    ranges: list[float] = field(default_factory=list)
    # lowest, highest: distances with the lowest upper and the highest lower bound, of one standard
    # deviation, so that uncertain values are neither
    lowest: Extreme | None = None
    highest: Extreme | None = None
    # median, low, high: distance in the median frame, and 5 % and 95 % quantiles, m; NaN without
    # any
    median: float = math.nan
    low: float = math.nan
    high: float = math.nan
    relative_stddev: float = math.nan  # standard deviation over distance in the median frame
    # 16, 50 and 84 % quantiles of each of `TOLD` that is known, medians over frames; m, or 1/m
    typical: dict[str, list[float]] = field(default_factory=dict)
    # numbers of frames by their clearest channel, which gives the distance
    channels: dict[str, int] = field(default_factory=dict)
    # smallest and largest distance, m, of frames that the filter rejected; empty without any
    rejected_distances: list[float] = field(default_factory=list)
    # medians of the first and the last third of single frames, m, if these rise or fall; see
    # `trend`
    trend: list[float] = field(default_factory=list)
    # distance, m, and number of frames of two groups of single frames, if any; see
    # `groups`
    groups: list[tuple[float, int]] = field(default_factory=list)
    # baseline by the calibration, m; smallest and largest if it changes
    baselines: list[float] = field(default_factory=list)
    # stamps of the frames before and after a gap that is most of the time, ns; see `gap`
    gap: list[int] = field(default_factory=list)

    @property
    def differs(self) -> bool:
        """Whether the smallest and the largest distance differ significantly."""
        low, high = self.lowest, self.highest
        return low is not None and high is not None and apart(
            low.value, low.stddev, high.value, high.stddev)

    @property
    def constant(self) -> bool:
        """Whether the distance is constant: no significant difference, trend or groups."""
        return not (self.differs or self.trend or self.groups)

    def state(self) -> dict[str, Any]:
        """Serialise for JSON, which has no NaN."""
        return {
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in asdict(self).items()
        }


def synopsis(
    columns: Columns, contrast: float, baselines: Collection[float]
) -> Synopsis:
    """Summarise the frames of a table.

    columns: columns of ``frames.csv`` by name. With several recordings there are no trend and
        groups, which need one water, and no gap.
    contrast: least visible contrast.
    baselines: baselines of the rigs of the frames, m.
    """
    stamps = columns["datetime"].tolist()
    own = np.isfinite(columns["visibility_distance"])
    series = columns["visibility_distance"][own]
    # If frames together refute the water, distances of single frames do not count.
    filtered = bool((columns["filtering"] != "").any())
    prefix = "filtered_" if filtered else ""
    distance, stddev = (columns[f"{prefix}visibility_distance{end}"] for end in ("", "_stddev"))
    known = np.isfinite(distance) & np.isfinite(stddev)
    surveyed = filtered & np.isfinite(distance)
    ranges = np.concatenate([
        columns[f"{kind}range_{end}"][chosen]
        for kind, chosen in (("", own), ("survey_", surveyed)) for end in ("min", "max")])
    rejected = series[columns["filtering"][own] == word(TrackingEvent.OUTLIER)]
    attenuation = np.stack([columns[f"attenuation_{channel}"][own] for channel in CHANNELS], 1)
    clearest = np.nanargmin(attenuation, axis=1) if own.any() else ()
    counts: dict[str, Any] = {
        "frames": len(stamps), "start": min(stamps, default=0), "end": max(stamps, default=0),
        "assessed": len(series), "told": int(known.sum()),
        "filtered": filtered, "contrast": contrast, "ranges": _ends(ranges),
        "channels": dict(Counter(CHANNELS[k] for k in clearest)),
        "rejected_distances": _ends(rejected),
        "baselines": sorted({min(baselines), max(baselines)}) if baselines else [],
        "gap": [] if TRANSECT in columns else gap(stamps),
    }
    if not known.any():
        return Synopsis(**counts)
    low, middle, high = np.percentile(distance[known], [5.0, 50.0, 95.0])
    series = series if series.size else distance[known]
    if TRANSECT in columns:
        series = series[:0]
    quantiles = {name: _quantiles(columns, prefix, name)[known] for name in TOLD}
    return Synopsis(
        **counts,
        lowest=_extreme(columns, distance, stddev, 1.0),
        highest=_extreme(columns, distance, stddev, -1.0),
        typical={
            name: np.nanmedian(values, axis=0).tolist() for name, values in quantiles.items()
            if np.isfinite(values).all(axis=1).any()},
        trend=trend(series), groups=groups(series),
        median=float(middle), low=float(low), high=float(high),
        relative_stddev=float(np.median(stddev[known] / distance[known])),
    )


def gap(stamps: Sequence[int]) -> list[int]:
    """Return the stamps before and after a gap that is more than half of the time, if any.

    A clock that is set forward during a recording makes one. The time from the first to the last
    frame is then not that of the recording.

    stamps: ns, in the order of frames.
    """
    steps = np.diff(stamps)
    if not steps.size:
        return []
    place = int(steps.argmax())
    if 2 * steps[place] <= max(stamps) - min(stamps) or steps[place] <= LONGEST_STEP * np.median(
            steps):
        return []
    return list(stamps[place:place + 2])


def _ends(values: Array) -> list[float]:
    """Return the smallest and the largest known value; empty without any."""
    known = values[np.isfinite(values)]
    return [float(known.min()), float(known.max())] if known.size else []


def _quantiles(columns: Columns, prefix: str, name: str) -> Array:
    """Return 16, 50 and 84 % of a quantity in each frame, (n, 3)."""
    ends = [f"{prefix}{name}{end}" for end in ("_low", "", "_high")]
    if ends[0] in columns:
        return np.stack([columns[end] for end in ends], 1)
    values = zip(columns[ends[1]], columns[f"{ends[1]}_stddev"], strict=True)
    return np.array([
        DerivedQuantities(**{name: value, f"{name}_stddev": stddev}).interval(name)
        for value, stddev in values])


def apart(low: float, low_stddev: float, high: float, high_stddev: float) -> bool:
    """Return whether two values differ significantly."""
    return high - low > SIGNIFICANT * math.hypot(low_stddev, high_stddev)


def _extreme(
    columns: Columns, distance: Array, stddev: Array, sign: float
) -> Extreme:
    """Return the smallest distance for certain (sign 1), or the largest one (sign -1)."""
    place = int(np.nanargmin(sign * distance + stddev))
    transect = str(columns[TRANSECT][place]) if TRANSECT in columns else ""
    return Extreme(
        transect, int(columns["frame"][place]), float(distance[place]), float(stddev[place]))


def trend(distance: Array) -> list[float]:
    """Return the medians of the first and the last third, m, of a series with a trend.

    Empty without a trend. By Kendall's test over medians of blocks of neighbours, whose errors are
    correlated.

    distance: (n,) float64, m, in the order of time.
    """
    if len(distance) < FEWEST or np.ptp(distance) == 0.0:
        return []
    blocks = np.array_split(distance, min(len(distance), JACKKNIFE_BLOCKS))
    medians = np.array([np.median(block) for block in blocks])
    chance = scipy.stats.kendalltau(np.arange(len(medians)), medians).pvalue
    # NaN if all are equal.
    if not chance < BY_CHANCE:
        return []
    third = -(-len(distance) // 3)
    return [float(np.median(distance[:third])), float(np.median(distance[-third:]))]


def groups(distance: Array) -> list[tuple[float, int]]:
    """Return two groups of a series, each with geometric mean, m, and number of frames; or nothing.

    Two normal distributions of the same width are fitted to the logarithms. The Bayesian
    information criterion compares them with one normal distribution, one around a line over time,
    and a uniform one.

    distance: (n,) float64, m, in the order of time.
    """
    n = len(distance)
    values = np.log(distance)
    if n < FEWEST or np.ptp(distance) == 0.0:
        return []
    above = values > 0.5 * (values.min() + values.max())
    member = np.column_stack((~above, above)).astype(np.float64)
    for _ in range(STEPS):
        weight = np.maximum(member.mean(axis=0), 1e-9)
        mean = values @ member / (n * weight)
        width = max(math.sqrt(np.sum(member * (values[:, None] - mean) ** 2) / n), NARROWEST)
        density = np.log(weight) - 0.5 * ((values[:, None] - mean) / width) ** 2
        member = softmax(density, axis=1)
    rivals = []
    for degree in (0, 1):
        left = values - np.polyval(np.polyfit(np.arange(n), values, degree), np.arange(n))
        alone = scipy.stats.norm.logpdf(left, 0.0, max(left.std(), NARROWEST)).sum()
        rivals.append(2.0 * alone - (2 + degree) * math.log(n))
    uniform = -2.0 * n * math.log(np.ptp(values)) - 2.0 * math.log(n)
    likelihood = logsumexp(density, axis=1).sum() - n * math.log(width * math.sqrt(2.0 * math.pi))
    evidence = 2.0 * likelihood - 4.0 * math.log(n) - max(*rivals, uniform)
    if evidence <= EVIDENCE or abs(mean[1] - mean[0]) <= SEPARATION * width:
        return []
    upper = member[:, 1] > 0.5
    if min(upper.sum(), (~upper).sum()) < 2:
        # A single frame that differs is no group.
        return []
    return [(math.exp(values[chosen].mean()), int(chosen.sum())) for chosen in (~upper, upper)]
