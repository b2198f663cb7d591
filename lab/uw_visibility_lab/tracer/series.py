# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Many traced scenes: drawn, rendered into one folder each, and taken up where they ended."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility_lab.tracer.engine import denoise
from uw_visibility_lab.tracer.files import TRUTH, exposure, truth_of, write_truth, write_view
from uw_visibility_lab.tracer.render import (
    AUXILIARY,
    Tracer,
    focal_length,
    image_guide,
    veil_guide,
)
from uw_visibility_lab.tracer.scene import Description, check_kind, draw_scene


def descriptions(
    scenes: int, seed: int, kinds: Sequence[str], lamps: int = 0,
) -> Iterator[tuple[str, Description]]:
    """Yield names of folders and what is in them, kinds in turn."""
    for kind in kinds:
        check_kind(kind)
    if not kinds:
        raise InputError("no kind of scene is given: give one at least, as in --kinds reef")
    for k in range(scenes):
        kind = kinds[k % len(kinds)]
        yield f"{seed + k:05d}_{kind}", draw_scene(seed + k, kind, lamps)


def render_scene(
    folder: Path, description: Description, size: tuple[int, int], samples: int, *,
    stereo: bool = False, threads: int = 2,
) -> bool:
    """Render a scene into a folder, unless it is complete already.

    folder: made if missing.
    size: width and height, px.
    samples: paths for each pixel and channel.
    stereo: also the right view.
    Returns whether it was rendered.
    """
    if (folder / TRUTH).exists():
        return False
    folder.mkdir(parents=True, exist_ok=True)
    left, gain = _view(description, size, samples, "left", None, threads)
    write_view(folder, "left", left)
    if stereo:
        # Both cameras have one exposure.
        right, _ = _view(description, size, samples, "right", gain, threads)
        write_view(folder, "right", right)
    write_truth(folder, truth_of(
        description, focal_length(description, size[0]), gain, samples, left))
    return True


def _view(
    description: Description, size: tuple[int, int], samples: int, view: str,
    gain: float | None, threads: int,
) -> tuple[dict[str, Array], float]:
    """Return a view's arrays, and its gain: that which is given, or the image's own."""
    tracer = Tracer(description, *size, view, threads)
    geometry = tracer.geometry()
    raw = tracer.radiance(samples)
    fewer = max(samples // AUXILIARY, 1)
    raw_black = tracer.radiance(fewer, black=True)
    black = denoise(raw_black, veil_guide(geometry))
    surface = denoise(
        tracer.radiance(fewer, through_water=False), geometry.reflectance, geometry.normals)
    image = denoise(raw, image_guide(surface, geometry, description))
    gain = exposure(image) if gain is None else gain
    return {
        "image": np.asarray(image * gain, np.float32), "raw": raw * gain,
        "raw_black": raw_black * gain, "black": black * gain, "surface": surface * gain,
        "ranges": geometry.ranges, "reflectance": geometry.reflectance}, gain
