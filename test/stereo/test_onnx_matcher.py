# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A network as matcher: against its twin in NumPy, against ELAS, and its confidence."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graphs import shifts, shifts_in_numpy
from scenes import ReefView

from uw_visibility import Pipeline, PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.images.network import Network
from uw_visibility.pipeline.warm_up import warm_up_pair
from uw_visibility.stereo.onnx_matcher import rate_difference
from uw_visibility.stereo.rig import DISPARITY_STDDEV, StereoRig
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.frame import RenderedFrame
from uw_visibility_lab.simulation.water import Water

MOST = 40
CAMERA = StereoCamera(width=320, height=240, focal_length=300.0, baseline=0.12)
VIEWS = {
    "ahead": (Pose((0.0, 0.0, 1.5), tilt=0.3), Water(0.2, 3.0)),
    "turbid": (Pose((1.0, -2.0, 1.2), tilt=0.15), Water(0.4, 2.0)),
}


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("onnx", reason="onnx is not installed")
    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    return shifts(tmp_path_factory.mktemp("model") / "shifts.onnx", MOST)


@functools.cache
def seen(view: str) -> RenderedFrame:
    pose, water = VIEWS[view]
    return ReefView(CAMERA, pose=pose, water=water).frame()


@pytest.fixture(params=VIEWS)
def frame(request: pytest.FixtureRequest) -> RenderedFrame:
    return seen(request.param)


def config(model: Path, **told: Any) -> PipelineConfig:
    return PipelineConfig.from_parameters({
        "stereo.max_disparity": MOST, "stereo.matcher": "onnx", "stereo.model": str(model),
        **{f"stereo.{name}": value for name, value in told.items()}})


def correct(disparity: np.ndarray, frame: RenderedFrame) -> float:
    """Share of the scene within 1 px of the truth."""
    truth = frame.disparity_left
    with np.errstate(invalid="ignore"):
        return float((np.abs(disparity - truth) <= 1)[np.isfinite(truth)].mean())


def test_the_graph_is_as_right_as_its_twin(model: Path, frame: RenderedFrame) -> None:
    left, right = (np.float32(image) / 255 for image in (frame.left, frame.right))
    made = Network(config(model).stereo, "stereo", 2, left.shape[:2], 1)
    found, twin = made.run(left, right), shifts_in_numpy(left, right, MOST)
    assert correct(twin, frame) > 0.5
    assert correct(found, frame) == pytest.approx(correct(twin, frame), abs=0.01)


def test_it_tells_of_the_same_water(model: Path, frame: RenderedFrame) -> None:
    pair = frame.left, frame.right
    plain = Pipeline(CAMERA.rig, config(model).built_in()).process(*pair)
    result = Pipeline(CAMERA.rig, config(model)).process(*pair)
    assert not np.array_equal(result.disparity, plain.disparity, equal_nan=True)
    expected = plain.visibility
    assert result.visibility.mean_attenuation == pytest.approx(
        expected.mean_attenuation, abs=expected.mean_attenuation_stddev)
    truth = frame.disparity_left
    matched = np.isfinite(result.disparity)
    # Gaps in open water, and where matches are wrong.
    assert matched[~np.isfinite(truth)].sum() < 0.02 * matched.sum()
    assert correct(result.disparity, frame) > 0.85 * matched[np.isfinite(truth)].mean()
    confidence = result.stereo.confidence
    assert confidence is not None
    np.testing.assert_array_equal(confidence > 0, matched)
    sure = matched & (confidence > 0.95)
    with np.errstate(invalid="ignore"):
        right = np.abs(result.disparity - truth) <= 1
    assert right[sure].mean() > right[matched].mean()


def test_restored_images_and_a_single_run(model: Path) -> None:
    frame = seen("ahead")
    for told in ({"network_images": "restored"}, {"network_check": False}):
        result = Pipeline(CAMERA.rig, config(model, **told)).process(frame.left, frame.right)
        assert correct(result.disparity, frame) > 0.7
        assert (result.stereo.confidence is None) == ("network_check" in told)


def test_grey_and_16_bit_images_and_reduction(model: Path) -> None:
    frame = seen("ahead")
    for kind in ("grey", "deep", "small"):
        pair = [frame.left, frame.right]
        if kind == "grey":
            pair = [image[..., 1].copy() for image in pair]
        if kind == "deep":
            pair = [image.astype(np.uint16) * 257 for image in pair]
        made = Pipeline(CAMERA.rig, config(model, reduction=2 if kind == "small" else 1))
        assert correct(made.process(*pair).disparity, frame) > 0.7, kind


def test_what_does_not_fit_is_refused(model: Path) -> None:
    with pytest.raises(InputError, match="matcher is 'raft': give one of elas, onnx"):
        Pipeline(CAMERA.rig, config(model, matcher="raft"))
    made = Pipeline(CAMERA.rig, config(model, min_confidence=0.5, network_check=False))
    with pytest.raises(InputError, match=r"min_confidence needs stereo\.network_check"):
        made.allocate((240, 320))


def test_views_tell_the_error_and_how_sure_a_match_is() -> None:
    """For errors drawn from the mixture, confidence is the share of correct matches."""
    rng = np.random.default_rng(1)
    stddev, wrong, searched = 0.8, 0.15, 60
    errors = rng.normal(0, stddev, (2, 400, 500))
    mismatch = rng.random((400, 500)) < wrong
    errors[0][mismatch] += rng.uniform(-searched, searched, mismatch.sum())
    found, confidence = rate_difference(np.float32(errors[0] - errors[1]), 3.0, searched)
    assert found == pytest.approx(stddev, rel=0.1)
    right = np.abs(errors[0]) <= 1
    for low, high in ((0.05, 0.5), (0.5, 0.7), (0.7, 1.0)):
        part = (confidence > low) & (confidence <= high)
        if part.sum() > 500:
            assert right[part].mean() == pytest.approx(confidence[part].mean(), abs=0.05)


def test_views_that_agree_wholly_are_not_taken_as_free_of_error() -> None:
    stddev, confidence = rate_difference(np.zeros((9, 9), np.float32), 2.0, 60)
    assert stddev == DISPARITY_STDDEV
    assert (confidence > 0.99).all()
    nothing = np.full((9, 9), np.nan, np.float32)
    stddev, confidence = rate_difference(nothing, 2.0, 60)
    assert stddev == DISPARITY_STDDEV
    assert (confidence == 0).all()


PLAIN = """
import sys
import numpy as np
from uw_visibility import Pipeline, StereoRig
from uw_visibility.pipeline.warm_up import warm_up_pair
Pipeline(StereoRig(200.0, 0.1, (79.5, 59.5))).process(*warm_up_pair((120, 160), np.dtype("u1")))
found = sorted(name for name in sys.modules if name.startswith("onnx"))
print("imported:", *found)
"""


def test_the_built_in_parts_import_no_onnxruntime() -> None:
    run = subprocess.run(
        [sys.executable, "-c", PLAIN], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    assert run.stdout.split() == ["imported:"]


def test_warming_up_compiles_the_built_in_parts(model: Path) -> None:
    from uw_visibility.pipeline.warm_up import warm_up_config

    assert warm_up_config(config(model)).stereo.matcher == "elas"
    # Whoever warms up with a network of any size may.
    pair = warm_up_pair((120, 160), np.dtype(np.uint8))
    Pipeline(StereoRig(200.0, 0.1, (79.5, 59.5)), config(model)).process(*pair)


def test_tiles_find_what_the_whole_does(model: Path, tmp_path: Path) -> None:
    tile = shifts(tmp_path / "tile.onnx", MOST, size=(90, 100))
    frame = seen("ahead")
    whole, tiled = (
        Pipeline(CAMERA.rig, each).process(frame.left, frame.right).disparity
        for each in (config(model), config(tile, large_images="tiled")))
    assert correct(tiled, frame) == pytest.approx(correct(whole, frame), abs=0.002)
