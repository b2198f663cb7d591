# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Calibration of a stereo pair from files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from uw_visibility.commands.calibration_file import read_camera_infos, read_rig
from uw_visibility.errors import InputError

P1 = [[400.0, 0.0, 160.0, 0.0], [0.0, 400.0, 120.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
P2 = [[400.0, 0.0, 150.0, -48.0], [0.0, 400.0, 120.0, 0.0], [0.0, 0.0, 1.0, 0.0]]


def matrix(rows: int, columns: int, data: list[float]) -> dict[str, Any]:
    return {"rows": rows, "cols": columns, "data": data}


def camera(projection: list[list[float]]) -> dict[str, Any]:
    """Return what camera_calibration writes for one camera."""
    return {
        "image_width": 320,
        "image_height": 240,
        "camera_name": "narrow_stereo/left",
        "camera_matrix": matrix(3, 3, [390.0, 0, 161, 0, 391, 121, 0, 0, 1]),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": matrix(1, 5, [-0.1, 0.01, 0, 0, 0]),
        "rectification_matrix": matrix(3, 3, [1, 0, 0, 0, 1, 0, 0, 0, 1]),
        "projection_matrix": matrix(3, 4, [value for row in projection for value in row]),
    }


def write(path: Path, content: Any) -> Path:
    dump = json.dumps if path.suffix == ".json" else yaml.safe_dump
    path.write_text(dump(content), encoding="utf-8")
    return path


def write_pair(folder: Path, **changes: Any) -> list[Path]:
    return [
        write(folder / "left.yaml", camera(P1)),
        write(folder / "right.yaml", {**camera(P2), **changes}),
    ]


def test_json_and_yaml_say_the_same(tmp_path: Path) -> None:
    content = {"P1": P1, "P2": P2, "width": 320, "height": 240}
    rig, size = read_rig([write(tmp_path / "pair.json", content)])
    assert (rig.focal_length, rig.baseline, rig.offset) == pytest.approx((400.0, 0.12, 10.0))
    assert size == (320, 240)
    assert read_rig(write_pair(tmp_path)) == (rig, size)


def test_a_file_of_opencv_is_named_as_such(tmp_path: Path) -> None:
    """As its stereo calibration writes P1 and P2."""
    path = tmp_path / "extrinsics.yml"
    path.write_text("%YAML:1.0\n---\nP1: !!opencv-matrix\n   rows: 3\n   cols: 4\n   dt: d\n")
    with pytest.raises(InputError, match=r"extrinsics\.yml .*OpenCV's FileStorage.* JSON file"):
        read_rig([path])


def test_the_size_is_unknown_where_json_does_not_state_it(tmp_path: Path) -> None:
    assert read_rig([write(tmp_path / "pair.json", {"P1": P1, "P2": P2})])[1] is None


def test_json_that_rectifies_says_how(tmp_path: Path) -> None:
    content: dict[str, Any] = {"P1": P1, "P2": P2, "width": 320, "height": 240}
    path = write(tmp_path / "pair.json", content)
    assert [info.k for info in read_camera_infos([path])] == [[400, 0, x, 0, 400, 120, 0, 0, 1]
                                                              for x in (160, 150)]
    missing = r"pair\.json has no K_left, D_left, R1, K_right, D_right, R2: .* --rectify"
    with pytest.raises(InputError, match=missing):
        read_camera_infos([path], rectify=True)
    for side in ("left", "right"):
        content[f"K_{side}"] = [[390, 0, 161], [0, 391, 121], [0, 0, 1]]
        content[f"D_{side}"] = [0.05, -0.01, 0.002, 0.0]
    content |= {name: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] for name in ("R1", "R2")}
    for model in ("plumb_bob", "equidistant"):
        content |= {"distortion_model": model} if model != "plumb_bob" else {}
        infos = read_camera_infos([write(path, content)], rectify=True)
        assert [info.distortion_model for info in infos] == [model] * 2
        assert (infos[0].k[0], infos[1].d[0]) == (390, 0.05)


@pytest.mark.parametrize(
    "content",
    [
        {}, [], {"P1": P1}, {"P1": P1, "P2": P2[:2]}, {"P1": P1, "P2": "x"},
        {"P1": P2, "P2": P1}, {"P1": P1, "P2": P1}, {"P1": P1, "P2": [[float("nan")] * 4] * 3},
        {"P1": P1, "P2": P2, "width": "320", "height": 240},
        {"P1": P1, "P2": P2, "width": 0, "height": 240},
    ],
)
def test_json_that_is_no_calibration_is_refused_by_name(tmp_path: Path, content: Any) -> None:
    with pytest.raises(InputError, match=r"pair\.json"):
        read_rig([write(tmp_path / "pair.json", content)])


@pytest.mark.parametrize(
    "changes",
    [
        {"image_width": 640}, {"image_width": None}, {"projection_matrix": None},
        {"projection_matrix": {"data": [1.0] * 11}}, {"camera_matrix": {"data": ["x"] * 9}},
        {"camera_matrix": {"data": ["1"] * 9}}, {"camera_matrix": {"data": [True] * 9}},
        {"camera_matrix": matrix(3, 3, [0.0] * 9)}, {"projection_matrix": matrix(3, 4, [0.0] * 12)},
    ],
)
def test_yaml_that_is_no_calibration_is_refused_by_name(
    tmp_path: Path, changes: dict[str, Any]
) -> None:
    with pytest.raises(InputError, match=r"right\.yaml"):
        read_rig(write_pair(tmp_path, **changes))


def test_one_camera_is_not_a_pair(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="left and the right"):
        read_rig(write_pair(tmp_path)[:1])
    with pytest.raises(InputError, match="3 files"):
        read_rig([tmp_path] * 3)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "broken.json").write_text("{", encoding="utf-8")
    (tmp_path / "broken.yaml").write_bytes(b"\x89PNG\xff")
    for name in ("absent.json", "broken.json", "broken.yaml"):
        with pytest.raises(InputError, match=name):
            read_rig([tmp_path / name])
