# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Synopsis of a replay: times, ranges, visibility and its course, a trend or a jump."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array
from uw_visibility.replay.columns import CHANNELS
from uw_visibility.replay.records import FrameEstimate, JoinedFrame
from uw_visibility.water.meaning.derived import DerivedQuantities
from uw_visibility.water.series.filter import FilteredWater
from uw_visibility.water.series.tracking import TrackingEvent

# Distances that differ by more than this many standard deviations are told apart.
SIGNIFICANT = 2.0
# Quantities that a verdict begins with, in this order.
TOLD = ("black_disc_visibility", "visibility_distance", "secchi_depth", "diffuse_attenuation_490")
# Place of the distance in `_values`.
DISTANCE = 2 + 3 * TOLD.index("visibility_distance")
# The trend is told from at most so many medians of neighbours: its test takes their square.
MOST_POINTS = 600
# Fewer values in order are one of 24 orders or fewer, which chance makes too often (5 %).
FEWEST = 5
# Values are told with three digits: a group is no narrower than that, as a part.
NARROWEST = 1e-3
# Two groups: strong evidence (Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572),
# and means farther apart than this many standard deviations of a group (Ashman, Bird and Zepf
# 1994, doi:10.1086/117248).
EVIDENCE, SEPARATION = 6.0, 2.0
# Steps of the fit of two groups.
STEPS = 200


@dataclass(frozen=True)
class Extreme:
    """Smallest or largest visibility distance of a recording."""

    frame: int  # number of the frame that shows it
    # value, stddev: m
    value: float
    stddev: float


@dataclass(frozen=True)
class Synopsis:
    """What a recording says of visibility as a whole."""

    frames: int  # all of them
    # start, end: first and last stamp, ns
    start: int
    end: int
    assessed: int  # frames that show a visibility distance by themselves
    told: int  # frames that have one: filtered over frames where `filtered`, else by themselves
    filtered: bool  # whether the distances below are the filtered ones
    contrast: float  # the smallest that counts as visible: what visibility distance is for
    # nearest and farthest range that the estimates rest on, m; empty without any
    ranges: list[float] = field(default_factory=list)
    # lowest, highest: smallest and largest distance for certain: those with the lowest upper and
    # the highest lower bound, of one standard deviation. A value that is hardly known is neither.
    lowest: Extreme | None = None
    highest: Extreme | None = None
    # median, low, high: distance in the median frame, and 5 % and 95 % quantiles, m; NaN without
    # any
    median: float = math.nan
    low: float = math.nan
    high: float = math.nan
    relative_stddev: float = math.nan  # standard deviation over distance in the median frame
    # 16, 50 and 84 % of each of `TOLD` that is known, each the median over frames; m, or 1/m
    typical: dict[str, list[float]] = field(default_factory=dict)
    # frames by the channel that decides, the clearest one
    channels: dict[str, int] = field(default_factory=dict)
    # smallest and largest distance, m, that frames show by themselves which the filter rejected;
    # empty without any
    rejected_distances: list[float] = field(default_factory=list)
    # medians of the first and the last third of the frames by themselves, m, where these rise or
    # fall; see `trend`
    trend: list[float] = field(default_factory=list)
    # distance, m, and number of frames of the two groups that they jump
    # between, if they do; see `groups`
    groups: list[tuple[float, int]] = field(default_factory=list)
    # the cameras' distance by their calibration, m; smallest and largest where it changes
    baselines: list[float] = field(default_factory=list)

    @property
    def differs(self) -> bool:
        """Whether the smallest and the largest distance can be told apart."""
        low, high = self.lowest, self.highest
        return low is not None and high is not None and apart(
            low.value, low.stddev, high.value, high.stddev)

    @property
    def constant(self) -> bool:
        """Whether nothing shows that the distance changes: no two values, no trend, no groups."""
        return not (self.differs or self.trend or self.groups)

    def state(self) -> dict[str, Any]:
        """Serialise for JSON, which has no NaN."""
        return {
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in asdict(self).items()
        }

    @classmethod
    def of_state(cls, state: Mapping[str, Any]) -> Synopsis:
        """Restore from the output of `state`."""
        found = dict(state)
        for name in ("median", "low", "high", "relative_stddev"):
            found[name] = math.nan if found[name] is None else float(found[name])
        for name in ("lowest", "highest"):
            found[name] = None if found[name] is None else Extreme(**found[name])
        return cls(**found)


class Findings:
    """Collects the values of each frame that a synopsis needs, 240 bytes a frame.

    contrast: smallest contrast that counts as visible.
    """

    def __init__(self, contrast: float) -> None:
        self._contrast = contrast
        self._frames, self._stamps = array("q"), array("q")
        # Rows of `_values`, of a frame by itself and filtered.
        self._told = array("d"), array("d")
        self._filtered = False
        self._channels: Counter[str] = Counter()
        self._ranges = (math.inf, -math.inf)
        self._rejected: list[float] = []
        self._baselines: list[float] = []

    def count(self, joined: JoinedFrame) -> None:
        """Take the next frame."""
        record, filtered = joined.record, joined.filtered
        # What frames together refute is not told, even of those that show a distance alone.
        self._filtered |= filtered is not None
        self._frames.append(record.frame)
        self._stamps.append(record.stamp)
        if record.estimate is not None:
            known = {*self._baselines, record.estimate.rig.baseline}
            self._baselines = sorted({min(known), max(known)})
        own, of_filter = _values(record.estimate, joined.derived), _values(
            filtered, joined.filtered_derived)
        for values, table in zip((own, of_filter), self._told, strict=True):
            table.extend(values)
        if record.estimate is not None and math.isfinite(own[DISTANCE]):
            self._count_view(record.estimate)
        if filtered is not None and filtered.survey is not None and math.isfinite(
                of_filter[DISTANCE]):
            self._extend(filtered.survey.range_min, filtered.survey.range_max)
        if filtered is not None and filtered.event is TrackingEvent.OUTLIER and math.isfinite(
                own[DISTANCE]):
            apart = [*self._rejected, own[DISTANCE]]
            self._rejected = [min(apart), max(apart)]

    def synopsis(self) -> Synopsis:
        """Return what the frames so far say."""
        own, filtered = (
            np.array(table).reshape(-1, 1 + 3 * len(TOLD)) for table in self._told)
        table = filtered if self._filtered else own
        stddev, distance = table[:, 0], table[:, DISTANCE]
        known = np.isfinite(distance) & np.isfinite(stddev)
        series = own[np.isfinite(own[:, DISTANCE]), DISTANCE]
        counts: dict[str, Any] = {
            "frames": len(self._frames),
            "start": min(self._stamps, default=0), "end": max(self._stamps, default=0),
            "assessed": len(series), "told": int(known.sum()),
            "filtered": self._filtered, "contrast": self._contrast,
            "ranges": list(self._ranges) if self._ranges[0] <= self._ranges[1] else [],
            "channels": dict(self._channels), "rejected_distances": list(self._rejected),
            "baselines": list(self._baselines),
        }
        if not known.any():
            return Synopsis(**counts)
        low, middle, high = np.percentile(distance[known], [5.0, 50.0, 95.0])
        numbers = np.array(self._frames)
        series = series if series.size else distance[known]
        quantiles = table[known, 1:].reshape(-1, len(TOLD), 3).swapaxes(0, 1)
        return Synopsis(
            **counts,
            lowest=_extreme(numbers, distance, stddev, 1.0),
            highest=_extreme(numbers, distance, stddev, -1.0),
            typical={
                name: np.nanmedian(values, axis=0).tolist()
                for name, values in zip(TOLD, quantiles, strict=True)
                if np.isfinite(values).all(axis=1).any()},
            trend=trend(series, SIGNIFICANT), groups=groups(series),
            median=float(middle), low=float(low), high=float(high),
            relative_stddev=float(np.median(stddev[known] / distance[known])),
        )

    def _count_view(self, estimate: FrameEstimate) -> None:
        water = estimate.water
        self._channels[CHANNELS[int(np.nanargmin(water.attenuation))]] += 1
        if water.envelope is not None and water.envelope.limits[1] > 0.0:
            self._extend(*water.envelope.limits)

    def _extend(self, low: float, high: float) -> None:
        self._ranges = min(self._ranges[0], float(low)), max(self._ranges[1], float(high))


def _values(
    source: FrameEstimate | FilteredWater | None, derived: DerivedQuantities | None
) -> list[float]:
    """Return the distance's σ, then 16, 50 and 84 % of each of `TOLD`; NaN where not known."""
    if source is None:
        return [math.nan] * (1 + 3 * len(TOLD))
    seen, derived = source.visibility, derived or DerivedQuantities()
    values = [seen.distance_stddev]
    for name in TOLD:
        values += (
            (seen.distance_low, seen.distance, seen.distance_high)
            if name == "visibility_distance" else derived.interval(name))
    return values


def apart(low: float, low_stddev: float, high: float, high_stddev: float) -> bool:
    """Return whether two values can be told apart."""
    return high - low > SIGNIFICANT * math.hypot(low_stddev, high_stddev)


def _extreme(frames: NDArray[np.int64], distance: Array, stddev: Array, sign: float) -> Extreme:
    """Return the smallest distance for certain (sign 1), or the largest one (sign -1)."""
    place = int(np.nanargmin(sign * distance + stddev))
    return Extreme(int(frames[place]), float(distance[place]), float(stddev[place]))


def trend(distance: Array, significant: float) -> list[float]:
    """Return the medians of the first and the last third, m, of a series that rises or falls.

    Without a trend there are none. The test is Kendall's, with the variance of correlated
    neighbours.

    distance: (n,) float64, m, in the order of time.
    significant: standard deviations of Kendall's statistic beyond which there is a trend.

    References
    ----------
    K. H. Hamed and A. R. Rao, A modified Mann-Kendall trend test for autocorrelated data, Journal
    of Hydrology 204, 1998, doi:10.1016/S0022-1694(97)00125-X.
    """
    if len(distance) < FEWEST or np.ptp(distance) == 0.0:
        return []
    parts = np.array_split(np.log(distance), min(len(distance), MOST_POINTS))
    values = np.array([np.median(part) for part in parts])
    n = len(values)
    time = np.arange(n, dtype=np.float64)
    ranks = scipy.stats.rankdata(values - scipy.stats.theilslopes(values, time).slope * time)
    ranks -= ranks.mean()
    lags = np.arange(1, n - 2)
    alike = np.array([ranks[:-lag] @ ranks[lag:] for lag in lags]) / max(ranks @ ranks, 1e-9)
    # Correlations that chance makes (5 %) do not count.
    alike[np.abs(alike) < 1.96 / math.sqrt(n)] = 0.0
    more = 2.0 * ((n - lags) * (n - lags - 1) * (n - lags - 2)) @ alike / (n * (n - 1) * (n - 2))
    variance = n * (n - 1) * (2 * n + 5) / 18.0 * max(1.0 + more, 1.0)
    tau = scipy.stats.kendalltau(time, values).statistic
    if not abs(tau) * n * (n - 1) / 2.0 > significant * math.sqrt(variance):
        return []
    third = -(-len(distance) // 3)
    return [float(np.median(distance[:third])), float(np.median(distance[-third:]))]


def groups(distance: Array) -> list[tuple[float, int]]:
    """Return the two groups that a series falls into: geometric mean, m, and frames; or nothing.

    Two normal distributions of one width are fitted to the logarithms. By the Bayesian
    information criterion they are held against a single one, one around a line over time, and a
    uniform one.

    distance: (n,) float64, m, in the order of time.
    """
    n = len(distance)
    values = np.log(distance)
    if n < FEWEST or np.ptp(distance) == 0.0:
        return []
    above = values > 0.5 * (values.min() + values.max())
    member = np.column_stack((~above, above)).astype(np.float64)
    for _ in range(STEPS):
        weight = member.mean(axis=0)
        mean = values @ member / np.maximum(member.sum(axis=0), 1e-9)
        width = max(math.sqrt(np.sum(member * (values[:, None] - mean) ** 2) / n), NARROWEST)
        density = weight * scipy.stats.norm.pdf(values[:, None], mean, width)
        total = np.maximum(density.sum(axis=1), 1e-300)
        member = density / total[:, None]
    rivals = []
    for degree in (0, 1):
        left = values - np.polyval(np.polyfit(np.arange(n), values, degree), np.arange(n))
        likelihood = scipy.stats.norm.logpdf(left, 0.0, max(left.std(), NARROWEST)).sum()
        rivals.append(2.0 * likelihood - (2 + degree) * math.log(n))
    uniform = -2.0 * n * math.log(np.ptp(values)) - 2.0 * math.log(n)
    evidence = 2.0 * np.log(total).sum() - 4.0 * math.log(n) - max(*rivals, uniform)
    if evidence <= EVIDENCE or abs(mean[1] - mean[0]) <= SEPARATION * width:
        return []
    upper = member[:, 1] > 0.5
    return [(math.exp(values[chosen].mean()), int(chosen.sum())) for chosen in (~upper, upper)]
