# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The vector operation against numpy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from uw_visibility.stereo.elas.absolute_difference import BYTES, descriptor_distance


@given(
    st.binary(min_size=BYTES, max_size=BYTES), st.binary(min_size=BYTES, max_size=BYTES),
    st.integers(0, 17), st.integers(0, 17),
)
def test_equals_the_sum_of_absolute_differences(a: bytes, b: bytes, i: int, j: int) -> None:
    """At any alignment, for any bytes, the extremes 0 and 255 included."""
    left = np.frombuffer(bytes(i) + a, np.uint8)
    right = np.frombuffer(bytes(j) + b, np.uint8)
    expected = np.abs(left[i:].astype(int) - right[j:]).sum()
    assert descriptor_distance(left, i, right, j) == expected
