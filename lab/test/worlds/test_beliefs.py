# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Beliefs are distributions with unit and source."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.worlds.beliefs import FORMS, beliefs, bounds, draw, happens, parse

MANY = 4000


def test_every_belief_has_a_form_and_a_source() -> None:
    found = beliefs()
    assert len(found) > 100
    for belief in found.values():
        assert belief.form in FORMS
        told = belief.source.startswith(("judgement", "issue")) or len(belief.source) > 12
        assert told, belief.name


@pytest.mark.parametrize("name", sorted(
    name for name, belief in beliefs().items() if belief.form in ("uniform", "log-uniform")))
def test_values_lie_within_their_bounds(name: str) -> None:
    low, high = bounds(name)
    rng = np.random.default_rng(2)
    drawn = np.array([draw(rng, name) for _ in range(200)])
    assert low <= drawn.min() and drawn.max() <= high
    assert np.ptp(drawn) > 0.5 * (
        high - low if beliefs()[name].form == "uniform" else 0.5 * (high - low) * low / high)


def test_forms_have_their_moments() -> None:
    rows = parse("""
[a]
uniform = { form = "uniform", low = 2.0, high = 4.0, unit = "m", source = "test" }
log = { form = "log-uniform", low = 0.1, high = 10.0, unit = "m", source = "test" }
normal = { form = "normal", mean = 3.0, stddev = 2.0, unit = "m", source = "test" }
lognormal = { form = "log-normal", median = 3.0, stddev = 0.5, unit = "m", source = "test" }
share = { form = "share", share = 0.3, unit = "", source = "test" }
choice = { form = "choice", values = [1, 5], weights = [1, 3], unit = "", source = "test" }
""")
    rng = np.random.default_rng(3)
    found = {name: np.array([row.draw(rng) for _ in range(MANY)]) for name, row in rows.items()}
    assert found["a.uniform"].mean() == pytest.approx(3.0, abs=0.05)
    assert np.median(found["a.log"]) == pytest.approx(1.0, rel=0.15)
    assert found["a.normal"].std() == pytest.approx(2.0, rel=0.05)
    assert np.log(found["a.lognormal"]).std() == pytest.approx(0.5, rel=0.05)
    assert found["a.share"].mean() == pytest.approx(0.3, abs=0.03)
    assert found["a.choice"].mean() == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize(("entry", "complaint"), [
    ('form = "uniform", low = 1.0, high = 2.0, unit = "m"', "no source"),
    ('form = "even", low = 1.0, high = 2.0, unit = "m", source = "x"', "form 'even'"),
    ('form = "uniform", low = 1.0, unit = "m", source = "x"', "no high"),
    ('form = "uniform", low = 3.0, high = 2.0, unit = "m", source = "x"', "low end above"),
    ('form = "log-uniform", low = 0.0, high = 2.0, unit = "m", source = "x"', "above 0"),
    ('form = "share", share = 1.5, unit = "", source = "x"', "from 0 to 1"),
    ('form = "choice", values = [1], weights = [1, 2], unit = "", source = "x"', "weight"),
    ('form = "uniform", low = nan, high = 2.0, unit = "m", source = "x"', "no low"),
])
def test_a_damaged_entry_is_refused_by_name(entry: str, complaint: str) -> None:
    with pytest.raises(InputError, match=rf"a\.b.*{complaint}"):
        parse(f"[a]\nb = {{ {entry} }}")


def test_an_unknown_belief_is_refused() -> None:
    with pytest.raises(InputError, match=r"water\.colour"):
        happens(np.random.default_rng(0), "water.colour")
