# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""MC-CNN as a peer, and what is said where it is not installed."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import stereo_pair, texture

from uw_visibility_lab.evaluation import mccnn
from uw_visibility_lab.evaluation.cases import MATCHES
from uw_visibility_lab.evaluation.report import SHORT_MATCHES


@pytest.mark.skipif(bool(mccnn.missing()), reason="MCCNN and libsgm are not installed")
def test_it_finds_a_shift_and_is_shown_beside_the_peers() -> None:
    left, right = (
        np.uint8(255 * image)
        for image in stereo_pair(texture((80, 168, 3), seed=1), 12.5, 140))
    found = mccnn.match(left, right, 31)
    inside = found[6:-6, 40:-6]
    assert np.isfinite(inside).mean() > 0.9
    assert np.nanmedian(inside) == pytest.approx(12.5, abs=0.3)
    # Where the right view does not reach, nothing is right.
    assert np.isnan(found[:, :10]).mean() > 0.5
    assert MATCHES["mccnn"] == mccnn.TITLE


def test_what_is_missing_is_named_by_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mccnn, "find_spec", lambda name: None if name == "mc_cnn" else name)
    assert mccnn.missing() == ["MCCNN"]


def test_each_matcher_has_a_column_on_the_terminal() -> None:
    assert len(SHORT_MATCHES) == len(MATCHES)
    assert ("mccnn" in MATCHES) is (not mccnn.missing()) is ("mccnn" in SHORT_MATCHES)
