# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters that cannot work are refused before the first frame, and no others are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from small_bags import HEIGHT, WIDTH

from uw_visibility.cli import main
from uw_visibility.images.files import write_png
from uw_visibility.replay.table import read_rows

pytestmark = pytest.mark.usefixtures("plain_report")


def replay(bag: Path, folder: Path, values: dict[str, Any], jobs: str = "1") -> int:
    """Replay a bag with parameters; returns the exit code."""
    file = folder / "params.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
    return main(["replay", str(bag), "-o", str(folder / "out"), "--params-file", str(file),
                 "--jobs", jobs])


@pytest.mark.parametrize("jobs", ["1", "2"])
@pytest.mark.parametrize(("values", "reason"), [
    ({"camera.flat_field": "/none.png"}, "camera.flat_field: cannot read image /none.png"),
    ({"camera.flat_field": "/dev/zero"}, "/dev/zero is no regular file"),
    ({"stereo.min_disparity": 100, "stereo.max_disparity": 50}, "leave at least 8 px"),
    ({"camera.response": "/none.csv"}, "no camera response '/none.csv'"),
    ({"depth_frame": ""}, "depth_frame is ''"),
])
def test_what_cannot_work_is_refused_before_the_first_frame(
    values: dict[str, Any], reason: str, jobs: str, recording: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert replay(recording, tmp_path, values, jobs) == 2
    said = capsys.readouterr().err
    assert reason in said and said.count("\n") == 1
    assert not list(tmp_path.glob("out*"))


def test_a_flat_field_of_the_images_size_is_used(recording: Path, tmp_path: Path) -> None:
    flat = np.full((HEIGHT, WIDTH, 3), 200, np.uint8)
    flat[:, : WIDTH // 2] = 100
    write_png(tmp_path / "flat.png", flat)
    assert replay(recording, tmp_path, {"camera.flat_field": str(tmp_path / "flat.png")}) == 0
    rows = list(read_rows(tmp_path / "out" / "frames.csv"))
    assert len(rows) == 4 and not any(row["reason"] for row in rows)


def test_disparities_that_the_images_have_are_searched(recording: Path, tmp_path: Path) -> None:
    """The small pair that kernels are compiled with has none of them."""
    values = {"stereo.min_disparity": 60, "stereo.max_disparity": 75}
    assert replay(recording, tmp_path, values) == 0
