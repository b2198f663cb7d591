# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The worlds' cameras."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.optics.transfer import to_linear
from uw_visibility_lab.worlds.camera import LINEAR, SRGB, Curve, draw_curve, record, told_linear

LIGHT = np.linspace(0.0, 1.0, 200)


def streams(purpose: str) -> np.random.Generator:
    return np.random.default_rng([11, len(purpose)])


def picture(value: float = 0.5) -> np.ndarray:
    return np.full((60, 80, 3), value, np.float32)


@pytest.mark.parametrize("curve", [
    LINEAR, SRGB, Curve("gamma", 1.8), Curve("log", 20.0), Curve("contrast", 0.5)])
def test_curves_rise_from_black_to_white(curve: Curve) -> None:
    code = curve.encode(LIGHT)
    assert code[0] == pytest.approx(0.0, abs=1e-6)
    assert code[-1] == pytest.approx(1.0)
    assert (np.diff(code) > 0.0).all()
    # Light of surfaces may lie beyond white.
    assert curve.encode(np.array([1.5]))[0] > 1.0


def test_a_curve_that_is_told_leaves_light_as_it_is() -> None:
    assert told_linear(SRGB, "srgb", np.array([0.1, 0.5, 1.2])) == pytest.approx(
        [0.1, 0.5, 1.2])


def test_truth_is_told_in_units_of_the_image() -> None:
    curve = Curve("gamma", 2.0)
    image = record(streams, picture(0.25), np.ones(3), curve, ("16 bit",))
    for told in ("linear", "srgb"):
        seen = to_linear(image, told)[0, 0]
        assert told_linear(curve, told, np.full(3, 0.25)) == pytest.approx(seen, rel=1e-3)


def test_told_curves_are_true_unless_foreign() -> None:
    rng = np.random.default_rng(0)
    assert draw_curve(rng, ()) == (LINEAR, "linear")
    assert draw_curve(rng, ("srgb",)) == (SRGB, "srgb")
    for _ in range(50):
        curve, told = draw_curve(rng, ("foreign curve",))
        assert curve.kind != told


def test_noise_grows_with_light_by_the_gain_of_balance() -> None:
    gains = np.array([2.0, 1.0, 1.0])
    bright, dark = (
        record(streams, picture(value), gains, LINEAR, ("noise", "16 bit")).astype(float)
        for value in (0.5, 0.05))
    spread = bright.std(axis=(0, 1)) / 65535 * 255
    assert 0.15 < spread[1] < 3.2
    assert spread[0] > 1.3 * spread[1]
    assert dark.std(axis=(0, 1))[1] < bright.std(axis=(0, 1))[1]
    assert bright.mean() == pytest.approx(0.5 * 65535, rel=0.01)


def test_vignetting_darkens_corners() -> None:
    image = record(streams, picture(), np.ones(3), LINEAR, ("vignetting",))
    assert image[0, 0, 0] < 0.96 * image[30, 40, 0]


def test_jpeg_and_bayer_keep_the_level() -> None:
    for name in ("jpeg", "bayer"):
        image = record(streams, picture(), np.ones(3), LINEAR, (name,))
        assert image.dtype == np.uint8
        assert image[10:-10, 10:-10].mean() == pytest.approx(127.5, abs=2.0)
