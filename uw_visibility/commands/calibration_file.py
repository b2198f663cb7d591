# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Calibration of a stereo pair from files: JSON with P1 and P2, or CameraInfo YAMLs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from uw_visibility.config.documents import read_document
from uw_visibility.errors import InputError, naming
from uw_visibility.stereo.rig import StereoRig

# Values of a JSON file that rectification needs beside P1 and P2.
TO_RECTIFY = ("K_left", "D_left", "R1", "K_right", "D_right", "R2")


def _info(**fields: Any) -> Any:
    """Return the calibration of one camera with the fields of a CameraInfo."""
    whole = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
    return SimpleNamespace(**fields, binning_x=0, binning_y=0, roi=whole)


def read_rig(paths: Sequence[str | Path]) -> tuple[StereoRig, tuple[int, int] | None]:
    """Read the geometry of a rectified pair.

    paths: one JSON file with the projection matrices ``P1`` and ``P2`` (3 by 4) and, where known,
        the ``width`` and ``height`` of the images; or the YAML files of the left and the right
        camera, as camera_calibration writes them.
    Returns `rig`, StereoRig; `size`, width and height of the calibrated images, px; None if not
    stated.
    Raises `InputError`, which names the file, if a file cannot be read or has another format, or
    if the numbers are not those of a rectified pair.
    """
    if len(paths) == 1:
        return _from_projection_file(Path(paths[0]))
    if len(paths) == 2:
        infos = [_camera_info(Path(path)) for path in paths]
        with naming(f"calibration {paths[0]}, {paths[1]}"):
            rig = StereoRig.from_camera_info(*infos)
        return rig, (infos[0].width, infos[0].height)
    raise InputError(
        f"--calibration names {len(paths)} files: give one JSON with P1 and P2, "
        "or the left and the right camera's YAML"
    )


def read_camera_infos(
    paths: Sequence[str | Path], *, rectify: bool = False
) -> tuple[Any, Any]:
    """Read the calibration of each camera of a pair, from which to `rectify` or not.

    paths: see `read_rig`. A JSON file must state ``width`` and ``height``; to rectify, it also
        needs `TO_RECTIFY`, and ``distortion_model`` unless that is ``plumb_bob``.
    Raises `InputError`, which names the file, if one cannot be read or has another format.
    """
    _, size = read_rig(paths)
    if len(paths) == 2:
        return _camera_info(Path(paths[0])), _camera_info(Path(paths[1]))
    path = Path(paths[0])
    content = _read(path)
    if size is None:
        raise InputError(f"calibration {path} has no width and height: add them, in pixels")
    missing = ", ".join(name for name in TO_RECTIFY if name not in content)
    if rectify and missing:
        raise InputError(
            f"calibration {path} has no {missing}: add them to rectify, or leave out --rectify")
    infos = []
    for side, number in (("left", 1), ("right", 2)):
        projection = np.asarray(content[f"P{number}"], np.float64)
        infos.append(_info(
            width=size[0],
            height=size[1],
            distortion_model=content.get("distortion_model", "plumb_bob"),
            k=_numbers(path, content, f"K_{side}", 9, projection[:, :3]),
            d=_numbers(path, content, f"D_{side}", absent=np.zeros(5)),
            r=_numbers(path, content, f"R{number}", 9, np.eye(3)),
            p=projection.ravel().tolist(),
        ))
    return infos[0], infos[1]


def _from_projection_file(path: Path) -> tuple[StereoRig, tuple[int, int] | None]:
    content = _read(path)
    if "projection_matrix" in content:
        raise InputError(
            f"calibration {path} is of one camera: "
            "name the left and the right camera's file, --calibration LEFT RIGHT"
        )
    if "P1" not in content or "P2" not in content:
        raise InputError(
            f"calibration {path} has no P1 and P2: give the projection matrices of the "
            "rectified left and right camera under these names"
        )
    with naming(f"calibration {path}"):
        rig = StereoRig.from_projection(content["P1"], content["P2"])
    known = "width" in content and "height" in content
    return rig, _size(path, content, "width", "height") if known else None


def _camera_info(path: Path) -> Any:
    """Read a camera's YAML file."""
    content = _read(path)
    width, height = _size(path, content, "image_width", "image_height")
    return _info(
        width=width,
        height=height,
        distortion_model=content.get("distortion_model", "plumb_bob"),
        k=_numbers(path, content, "camera_matrix", 9),
        d=_numbers(path, content, "distortion_coefficients"),
        r=_numbers(path, content, "rectification_matrix", 9),
        p=_numbers(path, content, "projection_matrix", 12),
    )


def _read(path: Path) -> dict[str, Any]:
    content = read_document(path, "calibration")
    if not isinstance(content, dict):
        raise InputError(
            f"calibration {path} has no named values: give a JSON with P1 and P2, "
            "or a pair of YAML files as camera_calibration writes them"
        )
    return content


def _size(path: Path, content: dict[str, Any], width: str, height: str) -> tuple[int, int]:
    columns, rows = content.get(width), content.get(height)
    if type(columns) is int and type(rows) is int and columns > 0 and rows > 0:
        return columns, rows
    raise InputError(
        f"calibration {path} has {width} {columns} and {height} {rows}: "
        "give the size of the calibrated images in pixels"
    )


def _numbers(
    path: Path, content: dict[str, Any], name: str, count: int | None = None, absent: Any = None
) -> list[float]:
    """Return the numbers under a name, as a list or as ``data`` below it; `count` if given."""
    found = content.get(name, absent)
    data = found.get("data") if isinstance(found, dict) else found
    values = np.asarray(data, object).ravel().tolist()
    numeric = all(
        isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        for value in values)
    if not numeric or len(values) != (count or len(values)):
        raise InputError(
            f"calibration {path} has no {f'{count} ' if count else ''}numbers under {name}: give "
            "the file that camera_calibration wrote for this camera, or a JSON with lists"
        )
    return [float(value) for value in values]
