# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility warmup`, and what is compiled after it: nothing."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from uw_visibility.cli import UNUSABLE, main

# Every kind of array that a camera's messages become, and rectified and corrected ones.
PROCESS = """\
import sys
import numpy as np
from uw_visibility import Pipeline, PipelineConfig, StereoRig, estimate_water
from uw_visibility.cli import main
from uw_visibility.compute.jit import counts
from uw_visibility.pipeline.warm_up import warm_up_pair
from uw_visibility.water.series.filter import WaterFilter

assert main(["warmup", "--size", "160x120"]) == 0
known = counts.loaded + counts.compiled
rig = StereoRig(200.0, 0.1, (119.5, 79.5))
plain = Pipeline(rig)
water_filter = WaterFilter(plain.config)
even = Pipeline(rig, PipelineConfig.from_parameters({"camera.vignetting": [-0.2, 0.0, 0.0]}))
for dtype in ("uint8", "uint16"):
    colour = warm_up_pair((160, 240), np.dtype(dtype))
    for pair in (colour, [image[..., 0] for image in colour]):
        message = [np.frombuffer(i.tobytes(), i.dtype).reshape(i.shape) for i in pair]
        padded = [np.concatenate((i, i), axis=1)[:, :240] for i in pair]
        flipped = [i[::-1] for i in pair]
        for number, images in enumerate((pair, message, padded, flipped)):
            result = plain.process(*images, match_original=True)
            water_filter.update(result.water, float(number))
            plain.process(*images, valid=np.ones((160, 240), bool), enhance=("left",))
    # Open water above the scene, brighter above.
    ahead = colour[0].copy()
    ahead[:60] = np.linspace(0.7, 0.4, 60)[:, None, None] * np.iinfo(dtype).max
    disparity = np.linspace(40.0, 5.0, 160, dtype=np.float32)[::-1, None] + np.zeros((160, 240))
    disparity[:60] = np.nan
    estimate_water(ahead, disparity.astype(np.float32), rig)
    assert counts.loaded + counts.compiled == known, dtype
    # The one kernel that only a lens with fall-off needs.
    known += 1
    even.process(*colour)
    assert counts.loaded + counts.compiled == known, dtype
"""


def warm_up(*arguments: str) -> int:
    """Return how many kernels a process of its own compiled."""
    process = subprocess.run(
        [sys.executable, "-m", "uw_visibility.cli", "warmup", *arguments],
        capture_output=True, text=True, check=True,
    )
    found = re.match(r"(\d+) kernels compiled, \d+ loaded, in [\d.]+ s; kept in ", process.stdout)
    assert found, process.stdout
    return int(found[1])


@pytest.mark.node
@pytest.mark.long
def test_the_second_time_nothing_is_compiled() -> None:
    warm_up("--size", "160x120")
    assert warm_up("--size", "320x240") == 0


@pytest.mark.node
def test_no_image_needs_a_kernel_that_was_not_warmed_up() -> None:
    """Else the first frame takes seconds after the node has said that it is ready."""
    process = subprocess.run(
        [sys.executable, "-c", PROCESS], capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr


@pytest.mark.parametrize("size", ["640", "20x20", "640xx480", "-1x5"])
def test_a_useless_size_is_refused(size: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warmup", f"--size={size}"]) == UNUSABLE
    assert "size" in capsys.readouterr().err
