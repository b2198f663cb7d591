# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the numbers of the posterior under lamps are fitted to."""

from __future__ import annotations

import numpy as np

from uw_visibility.water.lamps.posterior import FITTED
from uw_visibility_lab.posterior.lamps import observe, reefs, score


def test_a_reef_scores_better_by_the_fitted_numbers_than_by_absurd_ones() -> None:
    (case,) = reefs(1)
    night = observe(case)
    assert night is not None and len(night.nodes.range) > 100
    np.testing.assert_array_equal(night.attenuation, case.attenuation)
    # Ground whose trend may be anything, and next to no evidence.
    assert score(FITTED, night) > score(FITTED._replace(trend=1e3, evidence=0.01), night) + 0.1
