# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Rectified pair and rig from the four messages of a stereo frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Image, Mask
from uw_visibility.images.chroma import ChromaImage
from uw_visibility.images.pair import read_only
from uw_visibility.messages import images
from uw_visibility.messages.compressed import message_chroma, read_compressed, size_of
from uw_visibility.stereo.calibration import CameraInfo, image_size, matrix_of
from uw_visibility.stereo.rectification import Rectifier
from uw_visibility.stereo.rig import StereoRig


class StereoFrame(NamedTuple):
    """Synchronised messages: two images, Image or CompressedImage, and the CameraInfo of each."""

    left: Any
    right: Any
    left_info: CameraInfo
    right_info: CameraInfo


@dataclass(frozen=True, eq=False)
class StereoPair:
    """Rectified pair of images with its rig: the input of the pipeline."""

    # left, right: (H, W) or (H, W, 3) of uint8 or uint16, grey or RGB
    left: Image
    right: Image
    rig: StereoRig  # geometry of the pair
    # (H, W) bool: pixels of a left image rectified here that lie in the raw one; None for all
    valid: Mask | None
    # (x, y, width, height) of the bounding box of `valid`, px
    valid_window: tuple[int, int, int, int]
    encodings: tuple[str, str]  # encodings of the enhanced left and right image
    # colour of the left image at native resolution; None if its pixels have it in full
    chroma: ChromaImage | None = None


class FrameReader:
    """Reader of frames; keeps rig and rectification while CameraInfo stays the same.

    `calibrations` counts changes of CameraInfo, including the first one.
    """

    def __init__(self, rectify: bool) -> None:
        self._rectify = rectify
        self._key: tuple[Any, ...] = ()
        self._rig: StereoRig | None = None
        self._rectifier: Rectifier | None = None
        self.calibrations = 0

    def read(self, frame: StereoFrame) -> StereoPair:
        """Read the images of a frame, and rectify them if the reader is to."""
        # Checked before decompression, since a message may claim any size.
        _check_size(frame.left, frame.left_info, "left")
        _check_size(frame.right, frame.right_info, "right")
        left, left_encoding = read_pixels(frame.left, "left image")
        right, right_encoding = read_pixels(frame.right, "right image")
        encodings = left_encoding, right_encoding
        rig = self._calibrate(frame)
        chroma = message_chroma(frame.left, left)
        if self._rectifier is None:
            window = (0, 0, left.shape[1], left.shape[0])
            return StereoPair(left, right, rig, None, window, encodings, chroma)
        left, right = self._rectifier.rectify(left, right)
        if chroma is not None and chroma.pixels is not None:
            pixels = self._rectifier.rectify_reduced(chroma.pixels, chroma.scale)
            chroma = replace(chroma, pixels=read_only(pixels))
        valid, window = self._rectifier.valid, self._rectifier.valid_window
        return StereoPair(left, right, rig, valid, window, encodings, chroma)

    def _calibrate(self, frame: StereoFrame) -> StereoRig:
        key = _calibration_key(frame.left_info) + _calibration_key(frame.right_info)
        if self._rig is None or key != self._key:
            self._rig = None
            if self._rectify:
                self._rectifier = Rectifier(frame.left_info, frame.right_info)
                self._rig = self._rectifier.rig
            else:
                self._rig = StereoRig.from_camera_info(frame.left_info, frame.right_info)
            self._key = key
            self.calibrations += 1
        return self._rig


def read_pixels(message: Any, name: str) -> tuple[Image, str]:
    """Read an Image or CompressedImage: pixels, and the encoding of its enhanced image."""
    if hasattr(message, "format"):
        return read_compressed(message, name)
    return images.read_image(message, name), images.ENCODINGS[message.encoding].output


def _check_size(message: Any, info: CameraInfo, side: str) -> None:
    width, height = image_size(info, side)
    if hasattr(message, "format"):
        columns, rows = size_of(message, f"{side} image")
    else:
        columns, rows = images.image_view(message, f"{side} image").shape[1::-1]
    if (columns, rows) != (width, height):
        raise InputError(
            f"{side} image has {columns}x{rows} pixels and its camera_info "
            f"{width}x{height}: publish the camera_info of this image"
        )


def _calibration_key(info: CameraInfo) -> tuple[Any, ...]:
    matrices = tuple(matrix_of(info, name).tobytes() for name in "kdrp")
    roi = info.roi
    window = (roi.x_offset, roi.y_offset, roi.width, roi.height, info.binning_x, info.binning_y)
    return (info.width, info.height, info.distortion_model, *matrices, *window)
