# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A matcher beside the built-in one, in water and noise, and what it does to the estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.stereo.matchers import MATCHER
from uw_visibility_lab.evaluation.cases import Case, CaseResult, evaluate_case
from uw_visibility_lab.evaluation.degrade import title_of
from uw_visibility_lab.evaluation.parallel import Progress, run_cases
from uw_visibility_lab.evaluation.scenes import SceneSource
from uw_visibility_lab.evaluation.studies import mean
from uw_visibility_lab.evaluation.tables import as_text, number

HEAD = ("means over the scenes", "matched", "correct", "wrong", "|α̂ − α|", "score", "off, σ")


def compare_matchers(
    scenes: Sequence[SceneSource], attenuations: Sequence[float], depth: float,
    noises: Sequence[str], config: PipelineConfig, progress: Progress,
) -> str:
    """Return a table of the matcher of `config` and the built-in one, by water and noise.

    Score is the root mean square of the error of α over its σ, and the last column the largest
    difference of α to that with the built-in matcher, in σ of the latter.
    """
    groups = [(noise, attenuation) for noise in noises for attenuation in attenuations]
    cases = [
        Case(scene, attenuation, depth, noise=noise)
        for scene in scenes for noise, attenuation in groups]
    results = [
        run_cases(evaluate_case, cases, each, 1, progress) for each in (config.built_in(), config)]
    names = MATCHER, config.stereo.matcher
    rows = []
    for at, (noise, attenuation) in enumerate(groups):
        built_in, other = (each[at :: len(groups)] for each in results)
        for name, same in zip(names, (built_in, other), strict=True):
            rows.append((
                f"α {attenuation:g} 1/m, {title_of(noise)}, {name}", *_means(same, built_in)))
    return as_text(HEAD, rows)


def _means(cases: Sequence[CaseResult], built_in: Sequence[CaseResult]) -> list[str]:
    readings, beside = (
        [case.readings["pipeline"] for case in each] for each in (cases, built_in))
    errors = [
        reading.mean_attenuation - case.truth.mean_attenuation
        for case, reading in zip(cases, readings, strict=True)]
    squares = [
        (error / reading.mean_attenuation_stddev) ** 2
        for error, reading in zip(errors, readings, strict=True)]
    off = [
        abs(reading.mean_attenuation - other.mean_attenuation) / other.mean_attenuation_stddev
        for reading, other in zip(readings, beside, strict=True)]
    return [
        *(number(mean(getattr(case, name)["ours"] for case in cases), 3)
          for name in ("matched", "correct", "wrong")),
        number(mean(map(abs, errors)), 4), number(math.sqrt(mean(squares)), 2),
        number(float(np.nanmax(off)) if np.isfinite(off).any() else math.nan, 2)]
