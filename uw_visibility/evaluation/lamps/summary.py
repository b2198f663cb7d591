# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Summary statistics of the study under lamps."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uw_visibility.evaluation.lamps.survey import PICTURES, SurveyResult
from uw_visibility.evaluation.readings import CHANNELS, Reading, Truth
from uw_visibility.evaluation.studies import StudyResult, by_estimate, statistics
from uw_visibility.evaluation.summary import OK, Summary

NEAR = 0.2
"""Relative error of visibility up to which it is right."""


def summarise_lamps(results: Sequence[StudyResult], survey: SurveyResult | None) -> Summary:
    """Reduce a study to its summary.

    Returns
    -------
    dict
        ``told``: over all frames, by the names of `TOLD`; ``lamps``, ``attenuation`` and
        ``surfaces``: the same by these; ``survey``: what it found, or None.
    """
    return {
        "frames": len(results),
        "told": by_estimate(results, of_pairs),
        "lamps": _split(results, "lamps"),
        "attenuation": _split(results, "mean_attenuation"),
        "surfaces": _split(results, "surfaces"),
        "survey": None if survey is None else _of_survey(survey),
    }


def of_pairs(pairs: Sequence[tuple[Truth, Reading]]) -> Summary:
    """Return the adverse study's `statistics`, and how many are assessed and right.

    ``assessed`` and ``right`` (visibility within `NEAR`) are shares of all frames,
    ``right_of_assessed`` of those that are assessed.
    """
    found = statistics(pairs)
    errors = np.array([abs(r.distance / t.distance - 1.0) for t, r in pairs])
    assessed = np.isfinite(errors)
    right = errors <= NEAR
    found["assessed"] = float(assessed.mean())
    found["right"] = float(right.mean())
    found["right_of_assessed"] = float(right[assessed].mean()) if assessed.any() else math.nan
    return found


def _split(results: Sequence[StudyResult], label: str) -> dict[str, dict[str, Summary]]:
    parts: dict[str, list[StudyResult]] = {}
    for result in results:
        value = result.labels[label]
        parts.setdefault(value if isinstance(value, str) else f"{value:g}", []).append(result)
    return {name: by_estimate(some, of_pairs) for name, some in parts.items()}


def _of_survey(survey: SurveyResult) -> Summary:
    truth = survey.rows[-1].truth
    last = survey.rows[-1].pooled
    errors = np.array(last.attenuation) / np.array(truth.attenuation) - 1.0
    first = next(
        (k + 1 for k, row in enumerate(survey.rows) if row.pooled.status == OK), None)
    return {
        "frames": len(survey.rows),
        "cells": survey.cells,
        "views": survey.views,
        "single": of_pairs([(row.truth, row.single) for row in survey.rows]),
        "pooled": of_pairs([(row.truth, row.pooled) for row in survey.rows]),
        "first_assessed": first,
        "last_status": last.status,
        "attenuation": dict(zip(CHANNELS, truth.attenuation, strict=True)),
        "attenuation_error": dict(zip(CHANNELS, errors.tolist(), strict=True)),
        "variation": {
            name: dict(zip(CHANNELS, survey.variation[name].tolist(), strict=True))
            for name in PICTURES
        },
        "settled_variation": dict(zip(CHANNELS, survey.settled.tolist(), strict=True)),
        "colour_difference": {name: survey.difference[name] for name in PICTURES},
    }
