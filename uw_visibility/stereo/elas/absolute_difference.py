# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Sum of absolute differences of two 16-byte descriptors, as one vector operation.

Numba leaves LLVM's superword vectoriser off, so a loop over 16 bytes compiles to
16 scalar steps. The intrinsic below emits generic vector IR instead, which LLVM
lowers to what the machine has (PSADBW on x86-64, UABAL and ADDV on AArch64,
scalars elsewhere): nothing is x86-only, and the sum is the same integer anywhere.
"""

from __future__ import annotations

from typing import Any

from uw_visibility.compute.jit import njit
from uw_visibility.compute.numba_import import intrinsic, ir, types

BYTES = 16


def sum_of_differences(builder: Any, left: Any, right: Any) -> Any:
    """Emit the sum of absolute differences of 16 bytes each, as i32.

    Nothing in it belongs to a machine: where there are no vectors, LLVM makes it scalars.

    Parameters
    ----------
    builder : llvmlite.ir.IRBuilder
        Where to emit it.
    left, right : llvmlite.ir.Value
        Pointers to i8, of any alignment.

    Returns
    -------
    llvmlite.ir.Value
    """
    bytes_ = ir.VectorType(ir.IntType(8), BYTES)
    wide = ir.VectorType(ir.IntType(32), BYTES)
    first, second = (
        builder.zext(builder.load(builder.bitcast(pointer, bytes_.as_pointer()), align=1), wide)
        for pointer in (left, right)
    )
    absolute = builder.module.declare_intrinsic(
        f"llvm.abs.v{BYTES}i32", (), ir.FunctionType(wide, [wide, ir.IntType(1)])
    )
    magnitude = builder.call(
        absolute, [builder.sub(first, second), ir.Constant(ir.IntType(1), 0)]
    )
    reduce_add = builder.module.declare_intrinsic(
        f"llvm.vector.reduce.add.v{BYTES}i32", (), ir.FunctionType(ir.IntType(32), [wide])
    )
    return builder.call(reduce_add, [magnitude])


@intrinsic
def absolute_difference(typingctx: Any, a: Any, i: Any, b: Any, j: Any) -> Any:
    """Return ``sum(abs(a[i:i+16] - b[j:j+16]))`` as int32, from 1-D uint8 arrays.

    No bounds are checked.
    """

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


@njit(nogil=True)
def descriptor_distance(a: Any, i: int, b: Any, j: int) -> int:
    """Call the intrinsic from Python; for tests."""
    return absolute_difference(a, i, b, j)
