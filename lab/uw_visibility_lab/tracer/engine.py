# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Start of Mitsuba 3, choice of its variant and LLVM library, and Open Image Denoise."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Image

LLVM = "DRJIT_LIBLLVM_PATH"
"""Environment variable: the LLVM library of Mitsuba's compiler, Dr.Jit."""

FITTING_LLVM = range(16, 22)
"""Versions to look for. 14 is too old, and 15 crashes on some processors."""

PLACES = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib",
          "/usr/local/lib")


def find_llvm() -> str | None:
    """Return the newest suitable LLVM library of this machine, or None."""
    for version in reversed(FITTING_LLVM):
        for place in PLACES:
            for pattern in (f"libLLVM.so.{version}*", f"libLLVM-{version}.so*"):
                found = sorted(Path(place).glob(pattern))
                if found:
                    return str(found[0])
    return None


def missing(name: str) -> InputError:
    """Return the error for a missing package, with the command that installs it."""
    return InputError(
        f"path tracing needs {name}: install the lab's extra trace, pip install -e 'lab[trace]'")


@lru_cache(maxsize=1)
def mitsuba(threads: int = 2) -> Any:
    """Return Mitsuba with its variant set.

    The variant is llvm_ad_mono, which traces one channel at a time with its own free paths: in
    water red's are several times shorter than blue's, and paths drawn for one channel have
    unbounded weights in the other. Without a suitable LLVM library it is scalar_rgb, of which one
    channel is used: several times slower.

    Raises `InputError` if Mitsuba is not installed.
    """
    library = os.environ.get(LLVM) or find_llvm()
    if library:
        os.environ[LLVM] = library
    try:
        import drjit
        import mitsuba as mi
    except ImportError as error:
        raise missing("mitsuba") from error
    if mi.variant() is None:
        mi.set_variant("llvm_ad_mono" if library else "scalar_rgb")
    drjit.set_thread_count(threads)
    mi.set_log_level(mi.LogLevel.Error)
    return mi


def denoise(image: Image, guide: Image, normals: Image | None = None) -> Image:
    """Denoise a traced image (Open Image Denoise, filter RT, high dynamic range).

    Channels are denoised one by one: together, their means would change by 1 to 4 %.

    image: (H, W, 3) float32, linear, not below 0.
    guide: (H, W, 3) float32, 0 .. 1: guide of each channel, without noise. Its edges are copied to
        the image, so it should have only those of the image.
    normals: (H, W, 3) float32, of surfaces, without noise.
    Returns (H, W, 3) float32, not below 0.
    Raises `InputError` if pyoidn is not installed.
    """
    return np.stack([
        _denoise_channel(image[..., k], guide[..., k], normals) for k in range(3)], axis=-1)


def _denoise_channel(image: Image, guide: Image, normals: Image | None) -> Image:
    try:
        import pyoidn
    except ImportError as error:
        raise missing("pyoidn") from error
    height, width = image.shape
    # The network expects radiances near 1; a strongly attenuated channel is 1000 times darker.
    level = max(float(image.mean()), 1e-12)
    device = pyoidn.Device()
    device.commit()
    result = np.zeros((height, width, 3), np.float32)
    # These references are kept until the filter has run: it stores addresses only.
    given = {
        pyoidn.OIDN_IMAGE_COLOR: _threefold(image / level),
        pyoidn.OIDN_IMAGE_ALBEDO: _threefold(np.clip(guide, 0.0, 1.0)),
        pyoidn.OIDN_IMAGE_OUTPUT: result}
    if normals is not None:
        given[pyoidn.OIDN_IMAGE_NORMAL] = np.ascontiguousarray(normals, np.float32)
    run = pyoidn.Filter(device, "RT")
    for name, data in given.items():
        run.set_image(name, data, pyoidn.OIDN_FORMAT_FLOAT3, width, height)
    run.set_bool("hdr", True)
    # The guides have too little noise to be denoised first.
    run.set_bool("cleanAux", True)
    run.commit()
    run.execute()
    return np.maximum(result[..., 1] * level, 0.0)


def _threefold(channel: Image) -> Image:
    return np.ascontiguousarray(np.repeat(channel[..., None], 3, axis=-1), np.float32)
