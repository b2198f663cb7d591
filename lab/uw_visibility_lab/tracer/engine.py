# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Mitsuba 3 and Open Image Denoise: found, chosen and started once."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Image

LLVM = "DRJIT_LIBLLVM_PATH"
"""Environment: the LLVM library that Mitsuba's compiler, Dr.Jit, takes."""

FITTING_LLVM = range(16, 22)
"""Versions to look for. 14 is too old, and 15 ends the process on some processors."""

PLACES = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib",
          "/usr/local/lib")


def find_llvm() -> str | None:
    """Return the newest fitting LLVM library of this machine, or None."""
    for version in reversed(FITTING_LLVM):
        for place in PLACES:
            for pattern in (f"libLLVM.so.{version}*", f"libLLVM-{version}.so*"):
                found = sorted(Path(place).glob(pattern))
                if found:
                    return str(found[0])
    return None


def missing(name: str) -> InputError:
    """Return the error that says how to install what path tracing needs."""
    return InputError(
        f"path tracing needs {name}: install the lab's extra trace, pip install -e 'lab[trace]'")


@lru_cache(maxsize=1)
def mitsuba(threads: int = 2) -> Any:
    """Return Mitsuba, its variant chosen.

    That is llvm_ad_mono, where one channel at a time is traced, each with free paths of its own:
    in water red's are several times shorter than blue's, and paths drawn for one have weights
    without bound in the other. Without an LLVM library that fits it is scalar_rgb, of which
    one channel is used: several times slower.

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

    Channels go through it one by one: together, their means move by 1 to 4 %.

    image: (H, W, 3) float32, linear, not below 0.
    guide: (H, W, 3) float32, 0 .. 1: what each channel follows, without noise. What the image has
        not should not be in it: edges of the guide are taken over.
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
    # The network expects radiances about 1; where light is lost a channel is 1000 times less.
    level = max(float(image.mean()), 1e-12)
    device = pyoidn.Device()
    device.commit()
    result = np.zeros((height, width, 3), np.float32)
    # Held until the filter has run: it keeps addresses only.
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
    # The guides have no noise worth a pass of their own.
    run.set_bool("cleanAux", True)
    run.commit()
    run.execute()
    return np.maximum(result[..., 1] * level, 0.0)


def _threefold(channel: Image) -> Image:
    return np.ascontiguousarray(np.repeat(channel[..., None], 3, axis=-1), np.float32)
