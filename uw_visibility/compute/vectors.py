# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Loops over vectors of unsigned integers, for kernels that call them for each pixel.

Numba checks at every call of a loop whether its arrays overlap. Where the loop has a few vectors
only, such as the disparities of a pixel, these checks take longer than the rest. Loops written with
`Vectors` have none. They are emitted as generic vector IR, which LLVM lowers to the machine's
instructions: results are the same integers everywhere. Bounds are unchecked.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from uw_visibility.compute.numba_import import cgutils, ir, types

LANES = 32
"""Elements of a vector."""

_INDEX = ir.IntType(64)


class Vectors:
    """Instructions on vectors of `LANES` unsigned integers, inside the `codegen` of an intrinsic.

    Values have the bits of what they were made from; operands need the same number of bits.
    """

    def __init__(self, context: Any, builder: Any) -> None:
        self._context = context
        self.builder = builder

    def operands(self, signature: Any, arguments: Any) -> list[Any]:
        """Arguments of the intrinsic, arrays (1-D, contiguous) as pointers to their data."""
        return [
            self._context.make_array(kind)(self._context, self.builder, value).data
            if isinstance(kind, types.Array) else value
            for kind, value in zip(signature.args, arguments, strict=True)]

    @contextlib.contextmanager
    def loop(self, count: Any, step: int = LANES) -> Iterator[Any]:
        """Loop over `count` elements, which are whole vectors; gives the first index of each."""
        first, step = ir.Constant(_INDEX, 0), ir.Constant(_INDEX, step)
        with cgutils.for_range_slice(self.builder, first, count, step) as (k, _):
            yield k

    def constant(self, value: int | list[int], bits: int) -> Any:
        """The same integer in each element, or one for each."""
        values = value if isinstance(value, list) else [value] * LANES
        return ir.Constant(ir.VectorType(ir.IntType(bits), LANES), values)

    def filled(self, value: Any) -> Any:
        """A scalar in each element."""
        nothing = ir.Constant(ir.VectorType(value.type, LANES), ir.Undefined)
        first = self.builder.insert_element(nothing, value, ir.Constant(ir.IntType(32), 0))
        return self.builder.shuffle_vector(first, nothing, self.constant(0, 32))

    def load(self, array: Any, at: Any) -> Any:
        """Elements of an array from an index on."""
        return self.builder.load(self._place(array, at), align=1)

    def store(self, value: Any, array: Any, at: Any) -> None:
        """Write elements of an array from an index on."""
        self.builder.store(value, self._place(array, at), align=1)

    def variable(self, value: Any) -> Any:
        """A vector that a loop changes: `load` and `store` of `builder`; with its first value."""
        return cgutils.alloca_once_value(self.builder, value)

    def with_bits(self, value: Any, bits: int) -> Any:
        """The same integers with more or fewer bits."""
        change = self.builder.zext if bits > value.type.element.width else self.builder.trunc
        return change(value, ir.VectorType(ir.IntType(bits), LANES))

    def shifted(self, first: Any, second: Any, by: int) -> Any:
        """Elements of two vectors in a row, from the index `by` of the first on."""
        return self.builder.shuffle_vector(
            first, second, self.constant(list(range(by, by + LANES)), 32))

    def smaller(self, a: Any, b: Any) -> Any:
        """The smaller of both, element by element."""
        return self._call("umin", a.type, a, b)

    def apart(self, a: Any, b: Any) -> Any:
        """Absolute difference, element by element."""
        return self.builder.sub(self._call("umax", a.type, a, b), self.smaller(a, b))

    def smallest(self, value: Any) -> Any:
        """Smallest element, a scalar."""
        return self._call("vector.reduce.umin", value.type.element, value)

    def _call(self, name: str, result: Any, *values: Any) -> Any:
        kind = values[0].type
        function = self.builder.module.declare_intrinsic(
            f"llvm.{name}.v{LANES}i{kind.element.width}", (),
            ir.FunctionType(result, [kind] * len(values)))
        return self.builder.call(function, values)

    def _place(self, array: Any, at: Any) -> Any:
        vector = ir.VectorType(array.type.pointee, LANES)
        return self.builder.bitcast(self.builder.gep(array, [at]), vector.as_pointer())
