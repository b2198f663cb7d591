# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Lines between estimates and a sensor: truth within the standard deviations."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility.replay.line_fit import LARGEST, LineFit, fit_line


def draw(seed: int, noise: float = 0.03, count: int = 60) -> LineFit:
    rng = np.random.default_rng(seed)
    truth = np.linspace(0.2, 0.6, count)
    seen = truth + noise * rng.standard_normal(count)
    sensor = 1.0 + 4.0 * truth + 0.05 * rng.standard_normal(count)
    fit = fit_line(seen, np.full(count, noise), sensor, "/turbidity", "beam_attenuation")
    assert fit is not None
    return fit


def test_errors_of_the_estimates_do_not_flatten_the_line() -> None:
    fits = [draw(seed) for seed in range(60)]
    assert np.mean([fit.slope for fit in fits]) == pytest.approx(4.0, abs=0.1)
    scores = [(fit.slope - 4.0) / fit.slope_stddev for fit in fits]
    assert np.mean(np.abs(scores) < 2.0) > 0.85
    assert 0.6 < np.std(scores) < 1.5


def test_a_prediction_is_right_within_its_standard_deviation() -> None:
    for seed in range(20):
        value, stddev = draw(seed).predict(0.4, 0.02)
        assert abs(value - 2.6) < 3.0 * stddev
        # At least what the estimate is off by.
        assert stddev > 0.07


def test_nothing_is_said_far_outside_of_what_was_fitted() -> None:
    assert all(math.isnan(number) for number in draw(0).predict(1.5, 0.01))


def test_exact_estimates_give_the_plain_line() -> None:
    x = np.linspace(0.0, 1.0, 20)
    fit = fit_line(x, np.zeros(20), 3.0 - 2.0 * x)
    assert fit is not None
    assert (fit.intercept, fit.slope) == (pytest.approx(3.0), pytest.approx(-2.0))
    assert fit.slope_stddev == pytest.approx(0.0, abs=1e-9)


def test_values_on_a_line_leave_no_scatter_of_rounding() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        x = np.sort(rng.uniform(0.1, 0.4, 12))
        # The estimates' deviations account for more than what is off the line.
        fit = fit_line(x, np.full(12, 0.1), 1.1 * x + 0.003 * rng.standard_normal(12))
        assert fit is not None
        assert fit.residual_stddev == 0.0


def test_too_little_is_no_fit() -> None:
    x = np.linspace(0.0, 1.0, 20)
    assert fit_line(x[:7], x[:7], x[:7]) is None
    assert fit_line(np.full(20, 0.3), x, x) is None
    assert fit_line(np.full(20, np.nan), x, x) is None
    # Squares of these are zero in double precision.
    assert fit_line(x, x, 1e-200 * x) is None


def test_a_fit_is_kept_and_read(tmp_path: Path) -> None:
    fit = draw(0)
    fit.write(tmp_path / "fit.json")
    assert LineFit.read(tmp_path / "fit.json") == fit
    (tmp_path / "fit.json").write_text('{"slope": 1.0}')
    with pytest.raises(InputError, match="not a fit of a joined topic"):
        LineFit.read(tmp_path / "fit.json")
    (tmp_path / "fit.json").write_text('[1, 2]')
    with pytest.raises(InputError, match="not a fit of a joined topic"):
        LineFit.read(tmp_path / "fit.json")


@pytest.mark.parametrize(("name", "value"), [
    ("intercept_stddev", 1e200), ("slope", 1e308), ("covariance", -1e39),
])
def test_a_fit_beyond_single_precision_is_refused(
    name: str, value: float, tmp_path: Path
) -> None:
    (tmp_path / "fit.json").write_text(json.dumps(asdict(draw(0)) | {name: value}))
    with pytest.raises(InputError, match="not a fit of a joined topic"):
        LineFit.read(tmp_path / "fit.json")


def test_the_largest_fit_that_is_read_predicts(tmp_path: Path) -> None:
    names = ("intercept", "slope", "intercept_stddev", "slope_stddev", "covariance",
             "residual_stddev")
    (tmp_path / "fit.json").write_text(json.dumps(asdict(draw(0)) | dict.fromkeys(names, LARGEST)))
    value, stddev = LineFit.read(tmp_path / "fit.json").predict(0.4, 0.02)
    assert math.isfinite(value)
    assert math.isfinite(stddev)
