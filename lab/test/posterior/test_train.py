# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Training of the networks: which views are taken how often."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs the lab's extra: pip install ./lab[train]")

from uw_visibility_lab.posterior.examples import Examples
from uw_visibility_lab.posterior.train import importance

NUMBER = 20_000


def test_thickness_is_as_believed_whatever_the_views_were_drawn_with() -> None:
    rng = np.random.default_rng(0)
    thickness = rng.normal(-0.9, 1.15, NUMBER)
    truth = np.repeat(thickness[:, np.newaxis], 3, axis=1)[..., np.newaxis] + np.zeros((1, 3, 3))
    lamps = rng.random(NUMBER) < 0.03
    nothing = np.zeros((NUMBER, 0))
    often = importance(Examples(nothing, nothing, nothing, nothing, truth, lamps, lamps))
    day = ~lamps
    edges = np.log([0.15, 0.4, 1.0, 2.5])
    share = np.histogram(thickness[day], edges, weights=often[day])[0] / np.diff(edges)
    np.testing.assert_allclose(share, share.mean(), rtol=0.1)
    beyond = np.histogram(thickness[day], np.log([0.01, 0.04]), weights=often[day])[0]
    assert beyond[0] / np.log(4.0) < 0.2 * share.mean()
    assert often.min() > 0.0 and often[lamps] == pytest.approx(often[day].mean())
