# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Another matcher or restorer is an entry in a dictionary."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uw_visibility import Pipeline, PipelineConfig, StereoRig
from uw_visibility.enhancement.restorers import RESTORER, RESTORERS
from uw_visibility.images.view import View
from uw_visibility.pipeline.warm_up import warm_up_pair
from uw_visibility.stereo.matchers import MATCHER, MATCHERS

RIG = StereoRig(200.0, 0.1, (119.5, 79.5))
CONFIG = PipelineConfig.from_parameters({"stereo.max_disparity": 40})


def test_a_matcher_of_one_s_own_makes_the_disparity(monkeypatch: pytest.MonkeyPatch) -> None:
    class Shifted:
        """Everything is a pixel nearer."""

        def __init__(self, *arguments: Any) -> None:
            self._matcher = elas(*arguments)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._matcher, name)

        def dense_disparity(self, *arguments: Any, **options: Any) -> Any:
            match = self._matcher.dense_disparity(*arguments, **options)
            match.disparity[:] += 1
            return match

    pair = warm_up_pair((160, 240), np.dtype(np.uint8))
    before = Pipeline(RIG, CONFIG).process(*pair)
    elas = MATCHERS[MATCHER]
    monkeypatch.setitem(MATCHERS, MATCHER, Shifted)
    after = Pipeline(RIG, CONFIG).process(*pair)
    np.testing.assert_array_equal(after.disparity, before.disparity + 1)


def test_a_restorer_of_one_s_own_makes_the_images(monkeypatch: pytest.MonkeyPatch) -> None:
    class Inverse:
        def __init__(self, *arguments: Any) -> None:
            pass

        def restore(
            self, image: Any, range_map: Any, water: Any, noise: Any, known: Any
        ) -> Any:
            return 255 - image, known < 0.5

    monkeypatch.setitem(RESTORERS, RESTORER, Inverse)
    left, right = warm_up_pair((160, 240), np.dtype(np.uint8))
    result = Pipeline(RIG, CONFIG).process(left, right)
    np.testing.assert_array_equal(result.left_enhanced, 255 - left)
    np.testing.assert_array_equal(result.right_enhanced, 255 - right)


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_pairs_to_warm_up_with_are_both_noisy_and_smooth(grey: bool, dtype: type) -> None:
    """Matches are rated by other kernels in noise than without it."""
    code = 1 if dtype == np.uint8 else 256
    rough, smooth = (
        View.of(warm_up_pair((240, 320), np.dtype(dtype), grey=grey, smooth=smooth)[0]).noise
        for smooth in (False, True)
    )
    assert (rough > 2 * code).all()
    assert (smooth < 0.35 * code).all()
