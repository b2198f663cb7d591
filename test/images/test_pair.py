# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs that cannot be used say so in one sentence."""

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility.images.pair import check_pair, exposure_status
from uw_visibility.status import Status

GOOD = np.zeros((120, 160, 3), np.uint8)


@pytest.mark.parametrize(
    ("left", "right", "says"),
    [
        (GOOD.astype(np.float32), GOOD, "left image has type float32: give uint8 or uint16"),
        (GOOD, GOOD[..., :2], r"right image has shape \(120, 160, 2\): give"),
        (GOOD[:32, :48], GOOD[:32, :48], "left image is 48x32 px: give at least 96x64 px"),
        (GOOD, GOOD[:, :150], "left image is 160x120 px RGB uint8 and right image is 150x120"),
        (GOOD, GOOD[..., 0], "160x120 px grey uint8: give a pair of one size and type"),
        (GOOD, GOOD.astype(np.uint16), "give a pair of one size and type"),
    ],
)
def test_a_pair_that_does_not_fit_is_named(left, right, says):
    with pytest.raises(InputError, match=says):
        check_pair(left, right)


def test_views_become_contiguous_and_copies_are_not_made_without_need():
    left, right = check_pair(GOOD, GOOD[:, ::-1])
    assert np.shares_memory(left, GOOD)
    assert right.flags.c_contiguous


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_blindness_names_its_cause(dtype, channels):
    top = np.iinfo(dtype).max
    shape = (120, 160, *channels)
    noise = np.random.default_rng(0).integers(0, top, shape).astype(dtype)
    assert exposure_status(np.zeros(shape, dtype)) is Status.TOO_DARK
    assert exposure_status(np.full(shape, top, dtype)) is Status.SATURATED
    assert exposure_status(np.full(shape, top // 2, dtype)) is Status.NO_TEXTURE
    assert exposure_status(noise) is Status.OK
