# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Summary statistics of an evaluation; what is not assessable is counted beside them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from uw_visibility.status import Status
from uw_visibility_lab.evaluation.cases import IMAGES, MATCHES, READINGS, CaseResult
from uw_visibility_lab.evaluation.experiments import Evaluation
from uw_visibility_lab.evaluation.metrics import fraction_within, normalised_errors
from uw_visibility_lab.evaluation.readings import Reading, Truth

# Below this mean attenuation, 1/m, distances are beyond what a scene of a few metres tells.
TURBID = 0.05
# Mean attenuations are the same within this, 1/m, whatever was added and taken off again.
TELLING_APART = 1e-9
OK = str(Status.OK)

Pair = tuple[Truth, Reading, str]
Summary = dict[str, Any]


def summarise(evaluation: Evaluation) -> Summary:
    """Reduce an evaluation to its summary; all but ``noise`` is of cases without noise."""
    cases = evaluation.cases
    return {
        "cases": len(cases),
        "scenes": list(dict.fromkeys(case.scene for case in cases)),
        "water": {
            name: water_errors([(c.truth, c.readings[name], _label(c)) for c in cases])
            for name in READINGS
        },
        "disparity": _mean_disparity(cases),
        "colour_difference": _mean_colour(cases),
        "conditions": [
            {
                "mean_attenuation": attenuation,
                "depth": depth,
                "mean_attenuation_error": {
                    name: _absolute_errors(same, name) for name in READINGS
                },
                "disparity": _mean_disparity(same),
                "colour_difference": _mean_colour(same),
            }
            for attenuation in evaluation.plan.attenuations
            for depth in evaluation.plan.depths
            for same in [_of_water([c for c in cases if c.truth.depth == depth], attenuation)]
        ],
        "unmatched": _unmatched(cases),
        "noise": _noise(evaluation),
    }


def water_errors(pairs: Sequence[Pair]) -> Summary:
    """Errors of α, d_vis and z (mean, worst, and where), errors of β in σ, refusals by reason."""
    turbid = [pair for pair in pairs if pair[0].mean_attenuation >= TURBID]
    return {
        "mean_attenuation_error": _errors(pairs, _alpha_error),
        "distance_relative_error": _errors(pairs, _distance_error),
        "distance_relative_error_turbid": _errors(turbid, _distance_error),
        "depth_error": _errors(pairs, lambda t, r: abs(r.depth - t.depth)),
        "attenuation_within": _within(pairs, "attenuation"),
        "mean_attenuation_within": _within(pairs, "mean_attenuation"),
        "not_assessed": _reasons((r.status, name) for _, r, name in pairs),
        "distance_not_assessed": _reasons((r.distance_status, name) for _, r, name in pairs),
        "depth_not_assessed": _reasons((r.depth_status, name) for _, r, name in pairs),
    }


def _alpha_error(truth: Truth, reading: Reading) -> float:
    return abs(reading.mean_attenuation - truth.mean_attenuation)


def _distance_error(truth: Truth, reading: Reading) -> float:
    return abs(reading.distance / truth.distance - 1.0)


def _errors(pairs: Sequence[Pair], error: Callable[[Truth, Reading], float]) -> Summary:
    values = np.array([error(truth, reading) for truth, reading, _ in pairs], dtype=np.float64)
    known = np.flatnonzero(np.isfinite(values))
    worst = int(known[values[known].argmax()]) if known.size else None
    return {
        "mean": float(values[known].mean()) if known.size else float("nan"),
        "worst": float("nan") if worst is None else float(values[worst]),
        "worst_at": None if worst is None else pairs[worst][2],
        "assessed": int(known.size),
        "of": len(pairs),
    }


def _within(pairs: Sequence[Pair], name: str) -> Summary:
    errors = normalised_errors(
        [getattr(reading, name) for _, reading, _ in pairs],
        [getattr(truth, name) for truth, _, _ in pairs],
        [getattr(reading, f"{name}_stddev") for _, reading, _ in pairs],
    )
    shares = {f"{k}_sigma": fraction_within(errors, float(k)) for k in (1, 2, 3)}
    return {**shares, "of": int(errors.size)}


def _reasons(found: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """List the places of each reason, the most frequent reason first."""
    places: dict[str, list[str]] = {}
    for status, name in found:
        if status != OK:
            places.setdefault(status, []).append(name)
    order = Counter({reason: len(names) for reason, names in places.items()})
    return {reason: places[reason] for reason, _ in order.most_common()}


def _absolute_errors(cases: Sequence[CaseResult], name: str) -> float:
    return mean(_alpha_error(case.truth, case.readings[name]) for case in cases)


def _mean_disparity(cases: Sequence[CaseResult]) -> dict[str, dict[str, float]]:
    return {
        name: {
            "unmatched": mean(1.0 - case.matched[name] for case in cases),
            "correct": mean(case.correct[name] for case in cases),
        }
        for name in MATCHES
    }


def _unmatched(cases: Sequence[CaseResult]) -> list[Summary]:
    """Return the largest unmatched share over turbidity, by scene and depth (Fig. 6)."""
    places: dict[tuple[str, float], list[CaseResult]] = {}
    for case in cases:
        places.setdefault((case.scene, case.truth.depth), []).append(case)
    return [
        {
            "scene": scene,
            "depth": depth,
            "largest": {name: max(1.0 - c.matched[name] for c in same) for name in MATCHES},
            "above_oracle": max(
                c.matched["oracle_ours"] - c.matched["ours"] for c in same),
        }
        for (scene, depth), same in places.items()
    ]


def _noise(evaluation: Evaluation) -> list[Summary]:
    """Return means over the scenes for each noise and α, at one depth, without noise first."""
    plan = evaluation.plan
    if not evaluation.noisy:
        return []
    cases = [c for c in evaluation.cases if c.truth.depth == plan.shown[1]] + evaluation.noisy
    return [
        {
            "noise": noise,
            "mean_attenuation": attenuation,
            "depth": plan.shown[1],
            "mean_attenuation_error": {name: _absolute_errors(same, name) for name in READINGS},
            "disparity": {
                name: {
                    "correct": mean(case.correct[name] for case in same),
                    "unmatched": mean(1.0 - case.matched[name] for case in same),
                    "wrong": mean(case.wrong[name] for case in same),
                }
                for name in MATCHES
            },
        }
        for noise in ("0", *plan.noises)
        for attenuation in plan.attenuations
        for same in [_of_water([c for c in cases if c.noise == noise], attenuation)]
    ]


def _of_water(cases: Sequence[CaseResult], attenuation: float) -> list[CaseResult]:
    return [c for c in cases if abs(c.truth.mean_attenuation - attenuation) < TELLING_APART]


def _mean_colour(cases: Sequence[CaseResult]) -> dict[str, dict[str, float | int]]:
    return {
        name: {
            "mean": mean(case.colour_difference[name] for case in cases),
            "assessed": sum(np.isfinite(case.colour_difference[name]) for case in cases),
        }
        for name in IMAGES
    }


def mean(values: Iterable[float]) -> float:
    """Return the mean of those that are known; NaN of none."""
    known = np.array([value for value in values if np.isfinite(value)], dtype=np.float64)
    return float(known.mean()) if known.size else float("nan")


def _label(case: CaseResult) -> str:
    truth = case.truth
    return f"{case.scene}, α = {truth.mean_attenuation:.4g} 1/m, z = {truth.depth:g} m"
