# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Images of uneven illumination become even ones."""

import numpy as np
import pytest

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import CameraConfig
from uw_visibility.errors import InputError
from uw_visibility.images.chroma import ChromaImage
from uw_visibility.images.files import write_png
from uw_visibility.images.vignetting import FlatFieldCorrection, illumination
from uw_visibility.optics.transfer import from_linear, to_linear

SHAPE = (90, 120)
CENTRES = ((59.5, 44.5), (52.0, 47.0))
COEFFICIENTS = (-0.4, 0.1, -0.05)


def corrector(**config):
    return FlatFieldCorrection(CameraConfig(**config), CENTRES, Workers(2))


def scene(channels=3, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(0.1, 0.9, (*SHAPE, channels) if channels else SHAPE)


def seen(light, field, transfer="linear", dtype=np.uint16):
    return from_linear(light * (field[..., None] if light.ndim == 3 else field), transfer, dtype)


def test_nothing_is_done_and_nothing_copied_where_nothing_is_asked_for():
    left, right = (np.zeros((*SHAPE, 3), np.uint8) for _ in range(2))
    even = corrector()
    assert not even.needed
    assert even.correct(left, right)[0] is left
    assert even.correct(left, right)[1] is right


def test_the_polynomial_is_one_at_the_centre_and_its_sum_at_half_the_diagonal():
    field = illumination(COEFFICIENTS, (31, 41), (20.0, 15.0))
    assert field[15, 20] == 1
    np.testing.assert_allclose(field, field[::-1, ::-1])
    wide = illumination(COEFFICIENTS, (30, 40), (0.0, 0.0))
    assert wide[15, 20] == pytest.approx(1 + sum(COEFFICIENTS))


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [0, 3])
def test_a_vignette_about_each_image_s_centre_is_undone(transfer, dtype, channels):
    light = scene(channels)
    pair = [seen(light, illumination(COEFFICIENTS, SHAPE, c), transfer, dtype) for c in CENTRES]
    before = [image.copy() for image in pair]
    even = corrector(vignetting=COEFFICIENTS, transfer=transfer).correct(*pair)
    for image, original, kept in zip(even, pair, before, strict=True):
        assert image.dtype == dtype
        assert image.shape == original.shape
        np.testing.assert_array_equal(original, kept)
        tolerance = 0.02 if dtype == np.uint8 else 2e-4
        np.testing.assert_allclose(to_linear(image, transfer), light, atol=tolerance)


def test_what_is_saturated_stays_so_and_nothing_wraps_around():
    image = np.full((*SHAPE, 3), 255, np.uint8)
    image[:, :60] = 250
    left, _ = corrector(vignetting=COEFFICIENTS).correct(image, image)
    assert (left[:, 60:] == 255).all()
    assert (left >= image).all()
    # More light at the margin than at the centre, as with a lamp's ring.
    left, _ = corrector(vignetting=(0.5, 0.0, 0.0)).correct(image, image)
    assert (left[:, 60:] == 255).all()
    assert (left[:, :60] <= 250).all()


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_a_flat_field_of_any_colour_is_divided_out(tmp_path, transfer):
    field = illumination(COEFFICIENTS, SHAPE, CENTRES[0])
    write_png(tmp_path / "flat.png",
              from_linear(field[..., None] * [0.9, 0.5, 0.3], transfer, np.uint16))
    light = scene()
    image = seen(light, field, transfer)
    path = str(tmp_path / "flat.png")
    for even in corrector(flat_field=path, transfer=transfer).correct(image, image):
        np.testing.assert_allclose(to_linear(even, transfer), light, rtol=3e-3, atol=3e-3)
    grey = seen(scene(0), field, transfer)
    even, _ = corrector(flat_field=path, transfer=transfer).correct(grey, grey)
    np.testing.assert_allclose(to_linear(even, transfer), scene(0), rtol=3e-3, atol=3e-3)


def test_each_camera_may_have_its_own_flat_field(tmp_path):
    fields = [illumination(COEFFICIENTS, SHAPE, c) for c in CENTRES]
    for name, field in zip(("left", "right"), fields, strict=True):
        write_png(tmp_path / f"{name}.png", from_linear(field, "linear", np.uint16))
    light = scene()
    even = corrector(
        flat_field=str(tmp_path / "left.png"), flat_field_right=str(tmp_path / "right.png"),
    ).correct(*(seen(light, field) for field in fields))
    for image in even:
        np.testing.assert_allclose(to_linear(image, "linear"), light, atol=2e-3)


def test_the_result_is_the_same_for_any_number_of_threads():
    image = from_linear(scene(), "linear", np.uint8)
    results = [
        FlatFieldCorrection(CameraConfig(vignetting=COEFFICIENTS), CENTRES, Workers(n)).correct(
            image, image)[1] for n in (1, 3)
    ]
    np.testing.assert_array_equal(*results)


def test_a_flat_field_that_does_not_fit_is_refused(tmp_path):
    image = np.zeros((*SHAPE, 3), np.uint8)
    with pytest.raises(InputError, match=r"camera\.flat_field.*absent"):
        corrector(flat_field=str(tmp_path / "absent.png"))
    write_png(tmp_path / "small.png", np.full((10, 20), 200, np.uint8))
    with pytest.raises(InputError, match="20x10"):
        corrector(flat_field=str(tmp_path / "small.png")).correct(image, image)
    write_png(tmp_path / "black.png", np.zeros((*SHAPE, 3), np.uint8))
    with pytest.raises(InputError, match="without any light"):
        corrector(flat_field=str(tmp_path / "black.png"))


def test_colour_at_half_of_the_resolution_is_corrected_as_its_image():
    light = np.kron(scene()[::2, ::2], np.ones((2, 2, 1)))
    field = illumination(COEFFICIENTS, SHAPE, CENTRES[0])
    left = seen(light, field)
    half = left.reshape(45, 2, 60, 2, 3).mean(axis=(1, 3))
    colour = ChromaImage((half + 0.5).astype(np.uint16), 2)
    even = corrector(vignetting=COEFFICIENTS)
    even.correct(left, left)
    corrected = even.correct_chroma(colour)
    np.testing.assert_allclose(corrected.pixels / 65535, light[::2, ::2], atol=1e-3)
    assert corrected.scale == 2
    assert even.correct_chroma(None) is None
    assert corrector().correct_chroma(colour) is colour
