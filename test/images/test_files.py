# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Images and maps as files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility.images.files import read_image, write_pfm, write_png


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(7, 5), (7, 5, 3)])
def test_png_keeps_every_value(tmp_path: Path, dtype: type, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)
    write_png(tmp_path / "image.png", image)
    back = read_image(tmp_path / "image.png")
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, image)


def test_channels_are_red_green_blue(tmp_path: Path) -> None:
    bgra = np.zeros((2, 2, 4), np.uint8)
    bgra[...] = (1, 2, 3, 4)
    cv2.imwrite(str(tmp_path / "image.png"), bgra)
    assert read_image(tmp_path / "image.png")[0, 0].tolist() == [3, 2, 1]


def test_pfm_reads_back_elsewhere(tmp_path: Path) -> None:
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    values[1, 2] = np.inf
    write_pfm(tmp_path / "map.pfm", values)
    content = (tmp_path / "map.pfm").read_bytes()
    header, data = content.split(b"\n-1.0\n", 1)
    assert header == b"Pf\n4 3"
    # Rows from the bottom up, little endian.
    np.testing.assert_array_equal(np.frombuffer(data, "<f4").reshape(3, 4)[::-1], values)
    np.testing.assert_array_equal(
        cv2.imread(str(tmp_path / "map.pfm"), cv2.IMREAD_UNCHANGED), values
    )


def test_what_is_no_image_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "empty.png").touch()
    (tmp_path / "text.png").write_text("no image")
    cv2.imwrite(str(tmp_path / "float.tiff"), np.zeros((4, 4), np.float32))
    for name in ("absent.png", "empty.png", "text.png", "float.tiff", "."):
        with pytest.raises(InputError, match=str(tmp_path / name)):
            read_image(tmp_path / name)
    with pytest.raises(InputError, match=r"\(it has values of float32, not of 8 or 16 bit\): give"):
        read_image(tmp_path / "float.tiff")


@pytest.mark.parametrize("name", ["image.png", "image.jpg"])
def test_an_image_that_is_cut_off_is_refused(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    cv2.imwrite(str(path), np.random.default_rng(1).integers(0, 255, (64, 64, 3), np.uint8))
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(InputError, match=name):
        read_image(path)
    assert capfd.readouterr().err == ""


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    path = tmp_path / "absent" / "image.png"
    with pytest.raises(InputError, match=str(path)):
        write_png(path, np.zeros((4, 4), np.uint8))
