# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Sum of absolute differences of two 16-byte descriptors, as one vector operation.

Numba leaves LLVM's superword vectoriser off, so a loop over 16 bytes compiles to
16 scalar steps. The intrinsic below emits generic vector IR instead, which LLVM
lowers to what the machine has (PSADBW on x86-64, UABDL and UADDLV on AArch64,
scalars elsewhere): nothing is x86-only, and the sum is the same integer anywhere.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from uw_visibility.kernel_cache import njit

BYTES = 16


def _vector_at(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    pointer = builder.gep(data, [index])
    vector = ir.VectorType(ir.IntType(8), BYTES)
    return builder.load(builder.bitcast(pointer, vector.as_pointer()), align=1)


@intrinsic
def absolute_difference(typingctx: Any, a: Any, i: Any, b: Any, j: Any) -> Any:
    """Return ``sum(abs(a[i:i+16] - b[j:j+16]))`` as int32, from 1-D uint8 arrays.

    No bounds are checked.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        wide = ir.VectorType(ir.IntType(32), BYTES)
        left = _vector_at(context, builder, signature.args[0], arguments[0], arguments[1])
        right = _vector_at(context, builder, signature.args[2], arguments[2], arguments[3])
        difference = builder.sub(builder.zext(left, wide), builder.zext(right, wide))
        absolute = builder.module.declare_intrinsic(
            f"llvm.abs.v{BYTES}i32", (), ir.FunctionType(wide, [wide, ir.IntType(1)])
        )
        magnitude = builder.call(absolute, [difference, ir.Constant(ir.IntType(1), 0)])
        reduce_add = builder.module.declare_intrinsic(
            f"llvm.vector.reduce.add.v{BYTES}i32", (), ir.FunctionType(ir.IntType(32), [wide])
        )
        return builder.call(reduce_add, [magnitude])

    return types.int32(a, types.intp, b, types.intp), codegen


@njit(nogil=True)
def descriptor_distance(a: Any, i: int, b: Any, j: int) -> int:
    """Call the intrinsic from Python; for tests."""
    return absolute_difference(a, i, b, j)
