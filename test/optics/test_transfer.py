# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Code values to irradiance and back."""

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility.optics.transfer import encode_table, from_linear, linear_table, to_linear

TRANSFERS = ("linear", "srgb")
TYPES = (np.uint8, np.uint16)


@pytest.mark.parametrize("transfer", TRANSFERS)
@pytest.mark.parametrize("dtype", TYPES)
def test_every_code_value_survives_the_way_there_and_back(transfer, dtype):
    table = linear_table(transfer, dtype)
    codes = np.arange(len(table), dtype=dtype)
    assert (table[0], table[-1]) == (0, 1)
    assert (np.diff(table) > 0).all()
    np.testing.assert_array_equal(from_linear(table, transfer, dtype), codes)
    encode = encode_table(transfer, dtype)
    steps = (table.astype(np.float64) * (len(encode) - 1) + 0.5).astype(int)
    np.testing.assert_array_equal(encode[steps], codes)


def test_the_srgb_curve_at_published_values():
    # IEC 61966-2-1: the linear part ends at 0.04045; mid grey 0.5 is 0.21404.
    table = linear_table("srgb", np.uint16)
    assert table[32768] == pytest.approx(0.21404, abs=2e-5)
    assert table[1311] == pytest.approx(1311 / 65535 / 12.92, rel=1e-5)


def test_linear_is_proportional():
    np.testing.assert_allclose(linear_table("linear", np.uint8), np.arange(256) / 255, rtol=1e-6)


def test_encoding_clips_and_leaves_no_nan():
    light = np.array([-1.0, np.nan, 0.5, 2.0], dtype=np.float32)
    np.testing.assert_array_equal(from_linear(light, "linear", np.uint8), [0, 0, 128, 255])


def test_images_become_irradiance():
    image = np.array([[[0, 128, 255]]], dtype=np.uint8)
    irradiance = to_linear(image, "srgb")
    assert irradiance.dtype == np.float32
    np.testing.assert_allclose(irradiance, [[[0, 0.21586, 1]]], atol=1e-5)
    assert to_linear(irradiance, "srgb") is irradiance


def test_what_is_not_known_is_refused():
    with pytest.raises(InputError, match="gamma"):
        linear_table("gamma", np.uint8)
    with pytest.raises(InputError, match="int32"):
        from_linear(np.zeros(3), "linear", np.int32)


def test_tables_are_not_written_to():
    with pytest.raises(ValueError, match="read-only"):
        linear_table("srgb", np.uint8)[0] = 1
