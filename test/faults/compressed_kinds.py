# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Kinds of compressed images that no camera should send; see `message_kinds`."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from message_kinds import ANSWERED, ESCAPES, MessageKind, as_data, set_fields


def compressed_kinds(views: tuple[np.ndarray, np.ndarray]) -> Iterator[MessageKind]:
    """Yield what can be wrong with compressed images, for a node that subscribes to them."""
    def encoded(codec: str, pixels: np.ndarray, *options: int) -> bytes:
        return cv2.imencode(codec, np.ascontiguousarray(pixels[..., ::-1]), options)[1].tobytes()

    def right(content: bytes, kind: str = "rgb8; jpeg compressed bgr8") -> Any:
        return set_fields("right/image", data=as_data(content), format=kind)

    pixels = views[1]
    jpeg, png = encoded(".jpg", pixels), encoded(".png", pixels)
    progressive = encoded(".jpg", pixels, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    scan = jpeg.index(b"\xff\xda")
    middle = (scan + len(jpeg)) // 2
    frame = jpeg.index(b"\xff\xc0")
    last = progressive.rindex(b"\xff\xda")

    def with_frame(kind: int = 0xC0, bits: int = 8, height: int = 120, width: int = 160) -> bytes:
        head = struct.pack(">BBHBHH", 0xFF, kind, 17, bits, height, width)
        return jpeg[:frame] + head + jpeg[frame + 9 :]

    def png_size(width: int, height: int) -> bytes:
        head = b"IHDR" + struct.pack(">II", width, height) + png[24:29]
        return png[:12] + head + struct.pack(">I", zlib.crc32(head)) + png[33:]

    yield MessageKind("JPEG as it should be", right(jpeg), ANSWERED)
    yield MessageKind("PNG as it should be", right(png, "png"), ANSWERED)
    yield MessageKind("progressive JPEG", right(progressive), ANSWERED)
    for share in (0.1, 0.5, 0.9, 0.999):
        yield MessageKind(f"{share:.1%} of a JPEG", right(jpeg[: int(share * len(jpeg))]),
                          "truncated|damaged")
        yield MessageKind(f"{share:.1%} of a PNG", right(png[: int(share * len(png))], "png"),
                          "truncated|damaged")
    for name, content, kind, says in (
        ("half of a JPEG with its end", jpeg[:middle].removesuffix(b"\xff") + jpeg[-2:], "jpeg",
         "truncated|missing|damaged"),
        ("JPEG without its middle", jpeg[: middle - 300] + jpeg[middle:], "jpeg",
         "missing|damaged|left over"),
        ("JPEG with zeros", jpeg[:middle] + bytes(500) + jpeg[middle + 500 :], "jpeg",
         "missing|damaged|left over"),
        ("JPEG without scan", jpeg[:scan] + jpeg[-2:], "jpeg", "truncated|damaged"),
        ("progressive JPEG without its last scan", progressive[:last] + progressive[-2:], "jpeg",
         "truncated|missing"),
        ("JPEG of 200 scans", progressive[:last] + 200 * progressive[last:-2] + progressive[-2:],
         "jpeg", "scans"),
        ("JPEG of 30000x30000", with_frame(height=30_000, width=30_000), "jpeg", "30000x30000"),
        ("JPEG of 65535x1", with_frame(height=1, width=65_535), "jpeg", "65535x1"),
        ("JPEG without rows", with_frame(height=0), "jpeg", "0 pixels|160x0|damaged"),
        ("JPEG of 12 bits", with_frame(0xC1, 12), "jpeg", "damaged|decompress"),
        ("lossless JPEG", with_frame(0xC3), "jpeg", "neither baseline"),
        ("arithmetic JPEG", with_frame(0xC9), "jpeg", "neither baseline"),
        ("JPEG of another size", encoded(".jpg", pixels[:100]), "jpeg", "160x100"),
        ("grey JPEG", encoded(".jpg", pixels[..., :1]), "jpeg", "one size and type"),
        ("PNG of 30000x30000", png_size(30_000, 30_000), "png", "30000x30000"),
        ("PNG without columns", png_size(0, 120), "png", "0x120"),
        ("PNG with a wrong byte", png[:200] + bytes([png[200] ^ 1]) + png[201:], "png", "checksum"),
        ("PNG without pixels", png[:33] + png[-12:], "png", "damaged|decompress"),
        ("deep PNG", encoded(".png", pixels.astype(np.uint16) * 257), "png", "depth"),
        ("TIFF", encoded(".tiff", pixels), "tiff", "neither JPEG nor PNG"),
        ("GIF", b"GIF89a" + bytes(100), "gif", "neither JPEG nor PNG"),
        ("WebP", b"RIFF\0\0\0\0WEBPVP8 ", "webp",
         "'webp' and data that are neither JPEG nor PNG: publish"),
        ("text", b"<html>", "jpeg", "neither JPEG nor PNG"),
        ("nothing", b"", "jpeg", "neither JPEG nor PNG"),
        ("JPEG's first bytes alone", b"\xff\xd8\xff", "jpeg", "truncated|damaged"),
        ("PNG's first bytes alone", png[:8], "png", "truncated|damaged"),
        ("zeros", bytes(100_000), "jpeg", "neither JPEG nor PNG"),
        ("0xff alone", b"\xff" * 100_000, "jpeg", "neither JPEG nor PNG"),
        ("depth", jpeg, "32FC1; compressedDepth", "compressedDepth"),
        ("CMYK", _cmyk(pixels), "jpeg", ".*"),
    ):
        yield MessageKind(name, right(content, kind), says)
    for kind in ("", ESCAPES, "x" * 100_000, ";;;", "png", "bayer_rggb8; jpeg compressed "):
        yield MessageKind(f"JPEG called {kind[:20]!r}", right(jpeg, kind), ANSWERED)


def compressed_message(pixels: np.ndarray) -> Any:
    """Make a CompressedImage of an RGB image, without loss."""
    from sensor_msgs.msg import CompressedImage

    content = cv2.imencode(".png", np.ascontiguousarray(pixels[..., ::-1]))[1].tobytes()
    return CompressedImage(format="rgb8; png compressed bgr8", data=as_data(content))


def _cmyk(pixels: np.ndarray) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(pixels).convert("CMYK").save(file, "JPEG")
    return file.getvalue()
