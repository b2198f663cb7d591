# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged images, as files and as messages."""

from __future__ import annotations

import random
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
from fuzz import Outcome
from mutations import MUTATIONS, mutate
from small_bags import scene

from uw_visibility.errors import InputError
from uw_visibility.images.files import read_image
from uw_visibility.images.jpeg import file_chroma
from uw_visibility.messages.compressed import message_chroma, read_compressed

FORMATS = ("rgb8; jpeg compressed bgr8", "jpeg", "png", "mono16; png compressed ", "", "\0\x1b[2J",
           "bayer_rggb8; png compressed ", "compressedDepth", "x" * 100_000, ";;;", "rgb8;")
NAMES = (".jpg", ".png", ".tiff", ".ppm")


class Cases:
    """Images of several kinds, of which some bytes are changed."""

    case = ""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "image"
        left, _ = scene(1)
        deep = left.astype(np.uint16) * 257
        stored = [
            (".jpg", left, ()), (".jpg", left, (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)),
            (".jpg", left[..., 0], ()), (".jpg", left, (cv2.IMWRITE_JPEG_RST_INTERVAL, 3)),
            (".png", left, ()), (".png", deep, ()), (".png", left[..., 0], ()),
            (".tiff", left, ()), (".tiff", deep, ()), (".ppm", left, ()),
        ]
        self._images = [
            (name, cv2.imencode(name, np.ascontiguousarray(image), list(options))[1].tobytes())
            for name, image, options in stored
        ]

    def run(self, seed: int) -> Outcome:
        """Damage an image and read it."""
        rng = random.Random(seed)
        name, data = rng.choice(self._images)
        if rng.random() < 0.5:
            # Where sizes and tables are.
            what, head = mutate(data[:200], rng)
            data = head + data[200:]
        else:
            what, data = mutate(data, rng)
        if rng.random() < 0.1:
            data = rng.choice(MUTATIONS)(data, rng) if data else data
        self.case = f"{name} {what}"
        try:
            if rng.random() < 0.5:
                self._path.write_bytes(data)
                file_chroma(self._path, read_image(self._path))
            else:
                message = SimpleNamespace(format=rng.choice(FORMATS), data=data)
                message_chroma(message, read_compressed(message)[0])
        except InputError as error:
            return Outcome(self.case, "refused" if str(error).isprintable() else "unprintable")
        return Outcome(self.case, "read")
