# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimated and true state of the water, in one form for tables and figures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from uw_visibility.images.arrays import Array
from uw_visibility.optics.lamps import vector
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Visibility
from uw_visibility_lab.evaluation.judging import Answer, Judged
from uw_visibility_lab.simulation.camera import Triple

OK = str(Status.OK)


@dataclass(frozen=True)
class Truth:
    """True state of the water."""

    mean_attenuation: float  # α, 1/m
    depth: float  # z, m, positive down
    attenuation: Triple  # attenuation, ambient_light: β, 1/m, and I∞ for R, G, B
    ambient_light: Triple
    distance: float  # visibility distance (eq. 12), m

    @classmethod
    def of_water(
        cls, beta: Array, ambient_light: Array, clear_water_attenuation: Array, depth: float,
        contrast: float,
    ) -> Truth:
        """Derive everything from β, I∞ and κ, with the visible contrast of eq. 11."""
        return cls(
            float(np.mean(np.subtract(beta, clear_water_attenuation))), depth, vector(beta),
            vector(ambient_light), visibility_distance(float(np.min(beta)), contrast))


@dataclass(frozen=True)
class Reading:
    """Estimated state of the water with σ; NaN = not assessable."""

    # status, distance_status, depth_status: ``ok``, or the reason why the water, the visibility
    # distance or the depth is not assessable
    status: str
    distance_status: str
    depth_status: str
    attenuation: Triple  # attenuation, attenuation_stddev: β for R, G, B, 1/m
    attenuation_stddev: Triple
    ambient_light: Triple  # ambient_light, ambient_light_stddev: I∞ for R, G, B
    ambient_light_stddev: Triple
    mean_attenuation: float  # mean_attenuation, mean_attenuation_stddev: α, 1/m
    mean_attenuation_stddev: float
    distance: float  # distance, distance_stddev: visibility distance, m
    distance_stddev: float
    depth: float  # depth, depth_stddev: m, positive down
    depth_stddev: float

    @classmethod
    def of(cls, estimate: WaterEstimate, visibility: Visibility) -> Reading:
        """Reading of an estimate and its assessment."""
        return cls(
            str(estimate.status), str(visibility.status), str(visibility.depth_status),
            vector(estimate.attenuation), vector(estimate.attenuation_stddev),
            vector(estimate.ambient_light), vector(estimate.ambient_light_stddev),
            visibility.mean_attenuation, visibility.mean_attenuation_stddev,
            visibility.distance, visibility.distance_stddev,
            visibility.depth, visibility.depth_stddev,
        )

    @classmethod
    def refused(cls, reason: str) -> Reading:
        """Reading in which nothing was assessed, with the reason."""
        visibility = Visibility(Status.NO_TEXTURE, Status.NO_TEXTURE)
        reading = cls.of(WaterEstimate.not_assessable(Status.NO_TEXTURE), visibility)
        statuses = dict.fromkeys(("status", "distance_status", "depth_status"), reason)
        return cls(**{**vars(reading), **statuses})


def judged(truth: Truth, reading: Reading) -> Judged:
    """Return a reading and its truth, for the table of estimators."""
    attenuation = np.array(reading.attenuation)
    # Visibility distance at an attenuation of 1/m and the truth's contrast.
    metres = truth.distance * min(truth.attenuation)
    return Judged("", Answer(
        reading.distance_status, np.log(attenuation), reading.attenuation_stddev / attenuation,
        math.log(reading.distance / metres), reading.distance_stddev / reading.distance,
    ), np.array(truth.attenuation), math.nan)


def reasons_text(title: str, readings: Iterable[Reading]) -> list[str]:
    """Return the counts of the reasons for refusals in one line; no line without refusals."""
    counts = Counter(each.distance_status for each in readings)
    # Without the advice after a reason, which is in the tables.
    reasons = "; ".join(
        f"{reason.split(' (')[0]}: {n}" for reason, n in counts.most_common() if reason != OK)
    return [f"  {title}: {reasons}"] if reasons else []
