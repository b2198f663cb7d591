# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Records come back bit for bit, and what is none is refused."""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frame_records import frame_estimate, frame_record

from uw_visibility.errors import InputError
from uw_visibility.images.view import View
from uw_visibility.replay.frame_log import NAME, line_of, read_records
from uw_visibility.replay.records import FrameRecord
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.blocks import Blocks
from uw_visibility.water.estimate import LampLight
from uw_visibility.water.lamps.tracks import GroundView
from uw_visibility.water.observations import observe


def blocks() -> Blocks:
    rng = np.random.default_rng(1)
    light, ranges = rng.random((40, 60, 3), np.float32), rng.random((40, 60), np.float32)
    return Blocks(light, ranges, 0.7, np.zeros(3), np.ones(3), rng.random(3), True, False)


def records() -> list[FrameRecord]:
    estimate = frame_estimate(distance=1 / 3, depth=float("inf"))
    water = replace(
        estimate.water, envelope=observe(blocks()), blocks=blocks(), clearest=np.arange(3.0),
        light_covariance=np.eye(3))
    estimate = replace(estimate, water=water)
    return [
        frame_record(1.5, 3, estimate=estimate),
        frame_record(2.0, 4, reason="left image: “dark”\n"),
    ]


def write(folder: Path, *records: FrameRecord) -> Path:
    path = folder / NAME
    path.write_text("".join(map(line_of, records)), encoding="ascii")
    return path


def written(folder: Path) -> Path:
    return write(folder, *records())


def same(one: Any, other: Any) -> None:
    assert type(one) is type(other)
    if is_dataclass(one):
        for field in fields(one):
            same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, (tuple, dict)):
        assert len(one) == len(other)
        pairs = zip(one, other, strict=True) if isinstance(one, tuple) else (
            (one[name], other[name]) for name in one)
        for pair in pairs:
            same(*pair)
    elif isinstance(one, np.ndarray):
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
    else:
        assert one == other or one != one


def test_records_come_back_bit_for_bit(tmp_path: Path) -> None:
    written(tmp_path)
    found = list(read_records(tmp_path))
    assert len(found) == 2
    for one, other in zip(records(), found, strict=True):
        same(one, other)


def test_a_frame_under_lamps_comes_back_without_its_image(tmp_path: Path) -> None:
    estimate = frame_estimate()
    image = np.full((60, 80, 3), 90, np.uint8)
    rays = StereoRig(60.0, 0.1, (40.0, 30.0)).rays_at
    ground = GroundView.of(View.of(image), np.full((60, 80), 2.0, np.float32), rays, 0.01)
    light = LampLight(*np.full((5, 3), 0.2), ground=ground)
    object.__setattr__(estimate.water, "lamps", light)
    write(tmp_path, frame_record(1.5, 3, estimate=estimate))
    (found,) = read_records(tmp_path)
    assert found.estimate is not None
    same(found.estimate.water.lamps, replace(light, ground=None))


@pytest.mark.parametrize(("name", "value"), [
    ("light", np.zeros((3, 6, 3), np.float32)), ("light", np.zeros((4, 6), np.float32)),
    ("range", np.zeros((4, 7), np.float32)), ("noise", np.zeros(2))])
def test_blocks_whose_arrays_do_not_fit_are_refused(
    name: str, value: np.ndarray, tmp_path: Path
) -> None:
    """Compiled code goes by the shape of one of them."""
    record, _ = records()
    assert record.estimate is not None
    water = replace(
        record.estimate.water, blocks=blocks()._replace(**{name: value}))  # type: ignore[arg-type]
    write(tmp_path, replace(record, estimate=replace(record.estimate, water=water)))
    with pytest.raises(InputError, match="not a frame of a replay"):
        list(read_records(tmp_path))


def test_a_line_that_is_cut_off_ends_the_log(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_bytes(path.read_bytes()[:-1])
    assert [record.frame for record in read_records(tmp_path)] == [3]
    path.unlink()
    assert list(read_records(tmp_path)) == []


@pytest.mark.parametrize("change", [
    {"frame": "3"}, {"reason": None}, {"estimate": {"float": "0x1p0"}}, {"other": 1},
    {"estimate": {"StereoRig": {}}},
])
def test_what_is_no_record_is_refused(tmp_path: Path, change: dict[str, Any]) -> None:
    path = written(tmp_path)
    first, second = (json.loads(line) for line in path.read_text().splitlines())
    second["FrameRecord"] |= change
    path.write_text(json.dumps(first) + "\n" + json.dumps(second) + "\n")
    with pytest.raises(InputError, match=r"frames\.jsonl, line 2, is not a frame of a replay"):
        list(read_records(tmp_path))


@pytest.mark.parametrize("content", [
    b"\x80\x04\x95\n", b"[" * 100_000 + b"\n", b"{}\n", b"null\n",
    b'{"FrameRecord": {}}\n', b'{"Path": {"x": 1}}\n', b'{"<f8": "AAAA", "shape": [9]}\n',
])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / NAME).write_bytes(content)
    with pytest.raises(InputError, match="line 1, is not a frame of a replay: --force starts over"):
        list(read_records(tmp_path))
