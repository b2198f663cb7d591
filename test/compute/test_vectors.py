# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.compute.numba_import import intrinsic, types
from uw_visibility.compute.vectors import LANES, Vectors


@intrinsic
def half_apart(typingctx, here, there, count, target):
    """Write half the differences between a number and the elements; return the smallest sum."""

    def codegen(context, builder, signature, arguments):
        v = Vectors(context, builder)
        here, there, count, target = v.operands(signature, arguments)
        least = v.variable(v.constant(65535, 16))
        with v.loop(count) as k:
            other = v.load(there, k)
            half = builder.udiv(v.apart(v.filled(here), other), v.constant(2, 8))
            v.store(half, target, k)
            total = builder.add(v.with_bits(half, 16), v.with_bits(other, 16))
            builder.store(v.smaller(builder.load(least), total), least)
        return v.smallest(builder.load(least))

    return types.uint16(types.uint8, there, types.intp, target), codegen


@njit()
def halves(here, there, target):
    return half_apart(here, there, there.size, target)


def test_loops_calculate_like_numpy():
    random = np.random.default_rng(1)
    for vectors in (0, 1, 4):
        there = random.integers(0, 256, vectors * LANES).astype(np.uint8)
        target = np.zeros(vectors * LANES + 1, np.uint8)
        least = halves(np.uint8(100), there, target)
        half = np.abs(there.astype(int) - 100) // 2
        np.testing.assert_array_equal(target[:-1], half)
        # Nothing is written beyond the last vector.
        assert target[-1] == 0
        assert least == (min(half + there) if vectors else 65535)
