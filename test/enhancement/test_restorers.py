# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A network as restorer of images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graphs import save

from uw_visibility import Pipeline, PipelineConfig, StereoRig
from uw_visibility.errors import InputError
from uw_visibility.pipeline.warm_up import warm_up_pair

pytest.importorskip("onnx", reason="onnx is not installed")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

from onnx import helper, numpy_helper

RIG = StereoRig(200.0, 0.1, (119.5, 79.5))


@pytest.fixture(scope="module")
def negative(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A graph that makes 1 - x of an image 0..1."""
    return save(
        tmp_path_factory.mktemp("model") / "negative.onnx",
        [helper.make_node("Sub", ["one", "image"], ["restored"])],
        [numpy_helper.from_array(np.float32(1), "one")],
        inputs={"image": [1, 3, "h", "w"]}, outputs=("restored",))


def config(model: Path, **told: Any) -> PipelineConfig:
    return PipelineConfig.from_parameters({
        "stereo.max_disparity": 40, "enhancement.restorer": "onnx",
        "enhancement.model": str(model), **told})


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_it_makes_both_images_of_the_kind_that_came(
    negative: Path, dtype: type, grey: bool
) -> None:
    left, right = warm_up_pair((160, 240), np.dtype(dtype), grey=grey)
    result = Pipeline(RIG, config(negative)).process(left, right)
    white = np.iinfo(dtype).max
    for made, image in ((result.left_enhanced, left), (result.right_enhanced, right)):
        assert made.dtype == dtype
        np.testing.assert_allclose(made, float(white) - image, atol=1)
    assert not result.images.limited.any()


def test_what_does_not_fit_is_refused(negative: Path) -> None:
    with pytest.raises(InputError, match="restorer is 'clahe': give one of radiance, onnx"):
        Pipeline(RIG, config(negative, **{"enhancement.restorer": "clahe"}))
    with pytest.raises(InputError, match="does not know lamps"):
        Pipeline(RIG, config(negative, **{
            "lighting.model": "lamps", "lighting.positions": [0.3, 0.0, 0.0]}))
    with pytest.raises(InputError, match="must have 2 of one layout"):
        Pipeline(RIG, config(negative, **{
            "stereo.matcher": "onnx", "stereo.model": str(negative)}))
