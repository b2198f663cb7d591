# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The vector operation against numpy, and on other processors than this one."""

import ctypes
import re
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from llvmlite import ir

from uw_visibility.stereo.elas.absolute_difference import (
    BYTES,
    descriptor_distance,
    sum_of_differences,
)


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


def module() -> Any:
    """The vector operation alone, as a module of LLVM."""
    pointer = ir.IntType(8).as_pointer()
    made = ir.Module()
    function = ir.Function(made, ir.FunctionType(ir.IntType(32), [pointer, pointer]), "distance")
    builder = ir.IRBuilder(function.append_basic_block())
    builder.ret(sum_of_differences(builder, *function.args))
    return made


def machine(triple: str, **options: Any) -> Any:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    return llvm.Target.from_triple(triple).create_target_machine(opt=3, **options)


def host(**options: Any) -> tuple[Any, Any]:
    """Compile for this machine; return the function, and what has to live as long."""
    engine = llvm.create_mcjit_compiler(
        llvm.parse_assembly(str(module())), machine(llvm.get_process_triple(), **options)
    )
    engine.finalize_object()
    kind = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_char_p, ctypes.c_char_p)
    return kind(engine.get_function_address("distance")), engine


def test_special_instructions_give_the_same_as_the_plain_processor() -> None:
    own = host(cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten())
    plain = host()
    values = np.random.default_rng(5).integers(0, 256, (500, 2, BYTES), np.uint8)
    values[:100] = np.where(values[:100] < 128, 0, 255)
    for left, right in values:
        expected = np.abs(left.astype(int) - right).sum()
        assert own[0](left.tobytes(), right.tobytes()) == expected
        assert plain[0](left.tobytes(), right.tobytes()) == expected


@pytest.mark.parametrize(
    ("triple", "instruction"),
    [
        ("aarch64-linux-gnu", "addlv|addv"),
        ("armv7-linux-gnueabihf", "vabd|vpadd"),
        # It has no vectors, unless asked for: the same becomes scalars.
        ("riscv64-linux-gnu", "lbu"),
    ],
)
def test_other_processors_have_it_too(triple: str, instruction: str) -> None:
    source = llvm.parse_assembly(str(module()))
    source.triple = triple
    assert re.search(instruction, machine(triple).emit_assembly(source))
