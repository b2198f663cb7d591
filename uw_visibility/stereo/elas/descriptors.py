# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Descriptors of 16 Sobel responses per pixel (Geiger, Roser and Urtasun, ACCV 2010).

Numba turns LLVM's superword vectoriser off, so that a loop over a descriptor's 16 bytes compiles to
16 scalar steps. Their difference is emitted as generic vector IR instead, which LLVM lowers to the
machine's instructions (PSADBW on x86-64, UABAL and ADDV on AArch64, scalar ones elsewhere): the sum
is the same integer everywhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.numba_import import intrinsic, ir, types
from uw_visibility.compute.threads import Workers

BYTES = 16


def sum_of_differences(builder: Any, left: Any, right: Any) -> Any:
    """Emit the sum of absolute differences of 16 bytes at each of two pointers, as i32."""
    bytes_ = ir.VectorType(ir.IntType(8), BYTES)
    wide = ir.VectorType(ir.IntType(32), BYTES)
    first, second = (
        builder.zext(builder.load(builder.bitcast(pointer, bytes_.as_pointer()), align=1), wide)
        for pointer in (left, right)
    )
    absolute = builder.module.declare_intrinsic(
        f"llvm.abs.v{BYTES}i32", (), ir.FunctionType(wide, [wide, ir.IntType(1)])
    )
    magnitude = builder.call(absolute, [builder.sub(first, second), ir.Constant(ir.IntType(1), 0)])
    reduce_add = builder.module.declare_intrinsic(
        f"llvm.vector.reduce.add.v{BYTES}i32", (), ir.FunctionType(ir.IntType(32), [wide])
    )
    return builder.call(reduce_add, [magnitude])


@intrinsic
def absolute_difference(typingctx: Any, a: Any, i: Any, b: Any, j: Any) -> Any:
    """Return ``sum(abs(a[i:i+16] - b[j:j+16]))`` of 1-D uint8 arrays, int32; bounds unchecked."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        left, right = (
            builder.gep(
                context.make_array(signature.args[at])(context, builder, arguments[at]).data,
                [arguments[at + 1]],
            )
            for at in (0, 2)
        )
        return sum_of_differences(builder, left, right)

    return types.int32(a, types.intp, b, types.intp), codegen


# Half the side of the window that a descriptor samples.
MARGIN = 2
# Factor of the Sobel responses, to fit a byte. Strong edges clip: that yields more matches than a
# smaller factor, which rounds texture away.
SCALE = 0.5
MIDDLE = 128


class Descriptors:
    """Descriptor image of one view, in memory that is allocated once.

    horizontal, vertical: (H + 4, W + 4) uint8, Sobel responses with a border of two pixels; 128
        is a response of 0.
    values: (H * W * 16,) uint8, 16 such responses per pixel; the descriptor of pixel (u, v) begins
        at ``16 * (v * W + u)``.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        height, width = shape
        padded = (height + 2 * MARGIN, width + 2 * MARGIN)
        self.horizontal: NDArray[np.uint8] = np.empty(padded, np.uint8)
        self.vertical: NDArray[np.uint8] = np.empty(padded, np.uint8)
        self.values: NDArray[np.uint8] = np.empty(height * width * BYTES, np.uint8)

    def compute(
        self, grey: NDArray[np.uint16], gain: NDArray[np.float32], workers: Workers
    ) -> None:
        """Describe a grey image, given the gain of its gradients; see `ContrastNormalizer`."""
        height = grey.shape[0]
        workers.rows(_sobel, height + 2 * MARGIN, grey, gain, self.horizontal, self.vertical)
        workers.rows(_gather, height, self.horizontal, self.vertical, self.values)


@njit(nogil=True, inline="always")
def _byte(response: Any) -> np.uint8:
    shifted = response + np.float32(MIDDLE + 0.5)
    return np.uint8(min(max(shifted, np.float32(0)), np.float32(255)))


@njit(nogil=True)
def _sobel(
    start: int, stop: int, grey: Any, gain: Any, horizontal: Any, vertical: Any
) -> None:
    """Write Sobel responses; the border repeats those at the image's edge."""
    height, width = grey.shape
    for row in range(start, stop):
        y = min(max(row - MARGIN, 0), height - 1)
        above = grey[max(y - 1, 0)]
        here = grey[y]
        below = grey[min(y + 1, height - 1)]
        for x in range(1, width - 1):
            left = np.int32(above[x - 1]) + 2 * np.int32(here[x - 1]) + np.int32(below[x - 1])
            right = np.int32(above[x + 1]) + 2 * np.int32(here[x + 1]) + np.int32(below[x + 1])
            top = np.int32(above[x - 1]) + 2 * np.int32(above[x]) + np.int32(above[x + 1])
            bottom = np.int32(below[x - 1]) + 2 * np.int32(below[x]) + np.int32(below[x + 1])
            factor = np.float32(SCALE) * gain[y, x]
            horizontal[row, x + MARGIN] = _byte(factor * np.float32(right - left))
            vertical[row, x + MARGIN] = _byte(factor * np.float32(bottom - top))
        for x in range(MARGIN + 1):
            horizontal[row, x] = horizontal[row, MARGIN + 1]
            vertical[row, x] = vertical[row, MARGIN + 1]
            horizontal[row, width + 2 * MARGIN - 1 - x] = horizontal[row, width + MARGIN - 2]
            vertical[row, width + 2 * MARGIN - 1 - x] = vertical[row, width + MARGIN - 2]


@njit(nogil=True)
def _gather(start: int, stop: int, horizontal: Any, vertical: Any, values: Any) -> None:
    """Write eleven horizontal responses on a rhombus and five vertical ones on a cross.

    Horizontal responses discriminate along an epipolar line, so they are the majority.
    """
    width = horizontal.shape[1] - 2 * MARGIN
    for y in range(start, stop):
        h0, h1, h2 = horizontal[y], horizontal[y + 1], horizontal[y + 2]
        h3, h4 = horizontal[y + 3], horizontal[y + 4]
        v1, v2, v3 = vertical[y + 1], vertical[y + 2], vertical[y + 3]
        for x in range(width):
            at = (y * width + x) * BYTES
            values[at] = h0[x + 2]
            values[at + 1] = h1[x + 1]
            values[at + 2] = h1[x + 2]
            values[at + 3] = h1[x + 3]
            values[at + 4] = h2[x]
            values[at + 5] = h2[x + 1]
            values[at + 6] = h2[x + 2]
            values[at + 7] = h2[x + 3]
            values[at + 8] = h2[x + 4]
            values[at + 9] = h3[x + 2]
            values[at + 10] = h4[x + 2]
            values[at + 11] = v1[x + 2]
            values[at + 12] = v2[x + 1]
            values[at + 13] = v2[x + 2]
            values[at + 14] = v2[x + 3]
            values[at + 15] = v3[x + 2]
