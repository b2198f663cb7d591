# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Descriptors keep gradients and drop brightness."""

import ctypes
import re
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from llvmlite import ir

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.stereo.elas.descriptors import (
    BYTES,
    MIDDLE,
    Descriptors,
    absolute_difference,
    sum_of_differences,
)


@njit(nogil=True, cache=False)
def descriptor_distance(a: Any, i: int, b: Any, j: int) -> int:
    """Call the intrinsic from Python."""
    return absolute_difference(a, i, b, j)


def describe(grey, gain=1.0 / 256):
    """Return the descriptors of a grey image as (H, W, 16) int."""
    descriptors = Descriptors(grey.shape)
    descriptors.compute(grey, np.full(grey.shape, gain, np.float32), Workers(1))
    return descriptors.values.reshape(*grey.shape, 16).astype(int)


def test_a_constant_image_has_no_response():
    assert (describe(np.full((12, 14), 3000, np.uint16)) == MIDDLE).all()


def test_horizontal_and_vertical_ramps_respond_in_their_own_part():
    """A ramp of 2 levels per pixel: the Sobel response is 16 levels, halved 8."""
    ramp = np.tile(np.arange(14, dtype=np.uint16) * 512, (12, 1))
    across = describe(ramp)[4, 6] - MIDDLE
    np.testing.assert_array_equal(across, [8] * 11 + [0] * 5)
    down = describe(np.ascontiguousarray(ramp.T))[6, 4] - MIDDLE
    np.testing.assert_array_equal(down, [0] * 11 + [8] * 5)


def test_brightness_is_dropped_and_gain_undoes_contrast(texture):
    grey = texture((20, 24)).astype(np.uint16) * 64
    expected = describe(grey)
    np.testing.assert_array_equal(describe(grey + np.uint16(5000)), expected)
    quarter = grey // 4
    difference = describe(quarter * 4) - describe(quarter, gain=4.0 / 256)
    assert np.abs(difference).max() <= 1


def test_a_shifted_image_has_shifted_descriptors(texture):
    wide = texture((20, 40)).astype(np.uint16) * 64
    left, right = describe(wide[:, :30].copy()), describe(wide[:, 7:37].copy())
    # Without the border, where pixels are repeated.
    np.testing.assert_array_equal(left[:, 10:27], right[:, 3:20])


def test_strong_edges_clip_and_do_not_wrap():
    step = np.zeros((10, 12), np.uint16)
    step[:, 6:] = 65535
    values = describe(step)
    assert values.max() == 255
    assert values[5, 5, 6] == 255


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
    """An LLVM module with the vector operation only."""
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
    """Compile for this machine; return the function, and the object that must stay alive."""
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
        # Without vector instructions, the default there, scalar code is generated.
        ("riscv64-linux-gnu", "lbu"),
    ],
)
def test_other_processors_have_it_too(triple: str, instruction: str) -> None:
    source = llvm.parse_assembly(str(module()))
    source.triple = triple
    assert re.search(instruction, machine(triple).emit_assembly(source))
