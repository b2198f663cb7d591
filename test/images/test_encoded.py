# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Sizes that a few bytes claim, and images of which a part is missing."""

from __future__ import annotations

import io
import re
import struct
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image

from uw_visibility.errors import InputError
from uw_visibility.images.encoded import TruncatedError, decode, read_size

PIXELS = np.random.default_rng(1).integers(0, 255, (40, 56, 3), np.uint8)
CODECS = (".png", ".jpg", ".tiff", ".ppm")


def encoded(codec: str, pixels: np.ndarray = PIXELS, *options: int) -> bytes:
    return cv2.imencode(codec, pixels, list(options))[1].tobytes()


def with_size(codec: str, width: int, height: int) -> bytes:
    """Return an image of a few kilobytes that claims a size."""
    data = bytearray(encoded(codec))
    if codec == ".png":
        struct.pack_into(">II", data, 16, width, height)
        struct.pack_into(">I", data, 29, zlib.crc32(data[12:29]))
    elif codec == ".jpg":
        struct.pack_into(">HH", data, data.index(b"\xff\xc0") + 5, height, width)
    elif codec == ".ppm":
        return data.replace(b"56 40", f"{width} {height}".encode())
    else:
        order = "<" if data[:2] == b"II" else ">"
        (at,) = struct.unpack_from(f"{order}I", data, 4)
        for entry in range(struct.unpack_from(f"{order}H", data, at)[0]):
            place = at + 2 + 12 * entry
            (tag,) = struct.unpack_from(f"{order}H", data, place)
            if tag in (256, 257):
                value = width if tag == 256 else height
                struct.pack_into(f"{order}HII", data, place + 2, 4, 1, value)
    return bytes(data)


@pytest.mark.parametrize("codec", CODECS)
def test_size_is_that_of_the_pixels(codec: str) -> None:
    data = encoded(codec)
    assert read_size(data) == (56, 40)
    assert decode(data).shape == (40, 56, 3)


@pytest.mark.parametrize("codec", CODECS)
def test_an_absurd_size_is_refused_before_it_takes_memory(codec: str) -> None:
    for size in ((30_000, 30_000), (65_000, 2000), (0, 40)):
        with pytest.raises(InputError, match=f"{size[0]}x{size[1]}"):
            decode(with_size(codec, *size))


@pytest.mark.parametrize("options", [
    (), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1), (cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
])
def test_a_jpeg_that_is_cut_off_is_refused_though_its_preview_is_whole(
    options: tuple[int, ...]
) -> None:
    data = encoded(".jpg", PIXELS, *options)
    preview = encoded(".jpg", PIXELS[:16, :16].copy())
    # As cameras store it: in a segment before the image (Exif).
    segment = b"\xff\xe1" + struct.pack(">H", 8 + len(preview)) + b"Exif\0\0" + preview
    whole = data[:2] + segment + data[2:]
    np.testing.assert_array_equal(decode(whole), decode(data))
    # Drivers pad the end.
    np.testing.assert_array_equal(decode(whole + bytes(100)), decode(data))
    for share in (0.3, 0.5, 0.9, 0.999):
        with pytest.raises(TruncatedError):
            decode(whole[: int(share * len(whole))])


SMOOTH = cv2.GaussianBlur(PIXELS, (0, 0), 2.0)
# OpenCV writes other than 4:2:0 from 4.7 on.
SAMPLING_FACTOR = getattr(cv2, "IMWRITE_JPEG_SAMPLING_FACTOR", None)
SAMPLINGS = [
    pytest.param(
        (SAMPLING_FACTOR, getattr(cv2, f"IMWRITE_JPEG_SAMPLING_FACTOR_{name}", 0)), id=name,
        marks=pytest.mark.skipif(
            SAMPLING_FACTOR is None, reason=f"OpenCV {cv2.__version__} cannot write it"),
    )
    for name in ("411", "420", "422", "440", "444")
]


@pytest.mark.parametrize("options", [(), (cv2.IMWRITE_JPEG_RST_INTERVAL, 2), *SAMPLINGS])
@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("shape", [(40, 56), (37, 50), (9, 130)])
def test_a_jpeg_that_lost_its_second_half_is_refused_though_its_end_is_right(
    options: tuple[int, ...], colour: bool, shape: tuple[int, int]
) -> None:
    pixels = cv2.resize(SMOOTH, shape[::-1])
    whole = encoded(".jpg", pixels if colour else pixels[..., 0].copy(), *options)
    assert decode(whole).shape[:2] == shape
    assert decode(whole[:-2] + b"\xff\xff\xd9").shape[:2] == shape
    scan = whole.index(b"\xff\xda")
    half = whole[: (scan + len(whole)) // 2].removesuffix(b"\xff") + whole[-2:]
    with pytest.raises(InputError):
        decode(half)


@pytest.mark.parametrize("options", [(), (cv2.IMWRITE_JPEG_RST_INTERVAL, 5), *SAMPLINGS])
def test_a_jpeg_that_lost_a_part_on_its_way_is_refused(options: tuple[int, ...]) -> None:
    whole = encoded(".jpg", np.tile(PIXELS, (3, 3, 1)), *options)
    middle = (whole.index(b"\xff\xda") + len(whole)) // 2
    for damaged in (
        whole[:middle] + whole[middle + 500 :],
        whole[:middle] + bytes(500) + whole[middle + 500 :],
        whole[:middle] + whole[middle - 500 :],
    ):
        with pytest.raises(InputError):
            decode(damaged)


def test_what_a_codec_thinks_of_an_image_is_not_written_to_the_terminal(
    capfd: pytest.CaptureFixture[str]
) -> None:
    whole = encoded(".jpg", SMOOTH)
    # Some cameras leave a few bytes behind the codes.
    for padding in (b"", b"\x55\xaa\x55", bytes(2000)):
        padded = whole[:-2] + padding + whole[-2:]
        np.testing.assert_array_equal(decode(padded), decode(whole))
    with pytest.raises(InputError, match="left over"):
        decode(whole[:-2] + 40 * b"\x55" + whole[-2:])
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("options", [(), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1), *SAMPLINGS])
def test_pixels_of_a_jpeg_are_those_of_opencv(options: tuple[int, ...]) -> None:
    for pixels in (SMOOTH, SMOOTH[..., 0].copy()):
        data = encoded(".jpg", pixels, *options)
        expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(decode(data), expected)


@pytest.mark.parametrize("colour", [True, False])
def test_a_progressive_jpeg_that_lost_a_scan_is_refused(colour: bool) -> None:
    pixels = SMOOTH if colour else SMOOTH[..., 0].copy()
    data = encoded(".jpg", pixels, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    # A scan with the tables before it.
    begins = [data.rindex(b"\xff\xc4", 0, m.start()) for m in re.finditer(b"\xff\xda", data)]
    begins = sorted(set(begins[1:]))
    assert len(begins) > 3
    for begin, end in zip(begins, [*begins[1:], len(data) - 2], strict=True):
        with pytest.raises(TruncatedError, match="scans"):
            decode(data[:begin] + data[end:])


def test_a_jpeg_of_one_colour_is_whole() -> None:
    for value in (0, 128, 255):
        pixels = np.full((40, 56, 3), value, np.uint8)
        np.testing.assert_array_equal(decode(encoded(".jpg", pixels)), pixels)


def test_tables_that_a_camera_takes_for_known_are_left_to_the_decoder() -> None:
    data = encoded(".jpg", np.zeros((40, 56, 3), np.uint8))
    while (at := data.find(b"\xff\xc4")) >= 0:
        data = data[:at] + data[at + 2 + struct.unpack_from(">H", data, at + 2)[0]:]
    # Only newer decoders know them.
    if cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) is not None:
        assert decode(data).max() == 0


def test_a_png_with_a_wrong_byte_is_refused() -> None:
    data = encoded(".png")
    for place in (20, len(data) // 2, len(data) - 6):
        damaged = bytearray(data)
        damaged[place] ^= 16
        with pytest.raises(InputError):
            decode(bytes(damaged))
    with pytest.raises(TruncatedError):
        decode(data[:-12])


def test_a_jpeg_of_endless_scans_is_refused() -> None:
    data = encoded(".jpg", PIXELS, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    last = data.rindex(b"\xff\xda")
    with pytest.raises(InputError, match="scans"):
        decode(data[:last] + 200 * data[last:-2] + data[-2:])


@pytest.mark.parametrize("most", [1, 100, 1023, 4095, 65534])
def test_a_pnm_of_other_than_8_or_16_bit_is_refused(most: int) -> None:
    codes = bytes(12 if most < 256 else 24)
    with pytest.raises(InputError, match=f"its largest code is {most}, not that of 8 or 16 bit"):
        decode(b"P6\n2 2\n%d\n" % most + codes)


def test_comments_of_a_pnm_are_skipped() -> None:
    data = b"P5\n# a camera, 12 bit\n  # of 1 # 2\n2\n#3\n2\n# 100\n65535\n\0\1\0\2\0\3\0\4"
    assert decode(data).tolist() == [[1, 2], [3, 4]]
    # A pattern that tries every way to cut this would not end.
    with pytest.raises(InputError, match="neither"):
        decode(b"P5" + 1000 * b" #")


def with_tag(tag: int, value: int, pixels: np.ndarray) -> bytes:
    """Return a TIFF with the value of one of its tags."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "TIFF", tiffinfo={274: 1})
    data = bytearray(file.getvalue())
    (at,) = struct.unpack_from("<I", data, 4)
    place = next(
        p for p in range(at + 2, len(data), 12) if struct.unpack_from("<H", data, p)[0] == tag)
    struct.pack_into("<H", data, place + 8, value)
    return bytes(data)


@pytest.mark.parametrize("deep", [False, True])
def test_a_tiff_that_decoders_turn_or_invert_is_refused(deep: bool) -> None:
    pixels = PIXELS[..., 0].astype(np.uint16 if deep else np.uint8)
    np.testing.assert_array_equal(decode(with_tag(274, 1, pixels)), pixels)
    for orientation in (2, 3, 4, 6, 8):
        with pytest.raises(InputError, match=f"orientation {orientation}"):
            decode(with_tag(274, orientation, pixels))
    with pytest.raises(InputError, match="0 is white"):
        decode(with_tag(262, 0, pixels))


@pytest.mark.parametrize("data", [
    b"", b"\xff\xd8\xff", b"\xff\xd8\xff\xff" * 100, b"\x89PNG\r\n\x1a\n", b"II*\0",
    b"II*\0\xff\xff\xff\xff", b"P6 3 2 255\n", b"GIF89a" + bytes(100), bytes(100),
])
def test_what_is_no_image_is_refused(data: bytes) -> None:
    with pytest.raises(InputError):
        decode(data)
