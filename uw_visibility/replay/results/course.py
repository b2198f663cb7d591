# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Course of a series of distances: trend, or two groups that it jumps between."""

from __future__ import annotations

import math

import numpy as np
import scipy.stats

from uw_visibility.images.arrays import Array

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
