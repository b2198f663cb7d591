# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The real node by night: lamps told as parameters, and what it says where they are not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from uw_visibility.messages.images import read_image
from uw_visibility.status import Status
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.frame import RenderedFrame, Renderer
from uw_visibility_lab.simulation.lamps import Lighting, default_rig, lighting_parameters
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.water import Water

LAMPS = default_rig(2)
# The camera of the known scene, at twice its size.
CAMERA = StereoCamera(320, 240, 400.0, 0.1)


@pytest.fixture(scope="module")
def night() -> RenderedFrame:
    renderer = Renderer(CAMERA, lighting=Lighting(LAMPS, daylight=False))
    pose = Pose((0.0, 0.0, 1.5), tilt=np.radians(25.0))
    return renderer.render(reef(3, length=0.0), pose, Water(0.15, 40.0), seed=3)


@pytest.fixture(scope="module")
def frame(night: RenderedFrame, image: Any, info: Any) -> tuple[Any, ...]:
    return (
        image(night.left, "rgb8"), image(night.right, "rgb8"),
        info("left", scale=2), info("right", scale=2))


def arguments(parameters: dict[str, Any]) -> list[str]:
    return [part for name, value in parameters.items() for part in ("-p", f"{name}:={value}")]


def test_lamps_that_are_told_are_assessed_and_restored(
    start_node: Callable[..., Any], make_client: Callable[..., Any], night: RenderedFrame,
    frame: tuple[Any, ...],
) -> None:
    start_node(
        "-r", "__ns:=/night", *arguments(lighting_parameters(LAMPS, daylight=False)))
    client = make_client(namespace="/night")
    client.connect(*frame)
    stamp = client.publish(*frame)
    attenuation, stddev, distance, restored = client.result(
        stamp, "visibility/attenuation", "visibility/attenuation_stddev",
        "visibility/distance", "left/enhanced/image")
    found, sigma = (
        np.array([m.vector.x, m.vector.y, m.vector.z]) for m in (attenuation, stddev))
    assert (np.abs(found - night.attenuation) < 3 * sigma).all()
    assert (sigma < 0.5 * night.attenuation).all()
    true = 2.351 / night.attenuation.min()
    assert abs(distance.range - true) < 3 * np.sqrt(distance.variance) < 2.0 * true
    # By their light alone there is no depth to tell, and it is not told.
    assert not client.has("visibility/depth", stamp)
    assert client.diagnosed("pipeline", "").level is not None
    near = night.range_left > np.nanquantile(night.range_left, 0.5)
    assert read_image(restored)[near].mean() > 2.0 * night.left[near].mean()


def test_lamps_that_are_not_told_are_asked_for(
    start_node: Callable[..., Any], make_client: Callable[..., Any], frame: tuple[Any, ...],
) -> None:
    start_node("-r", "__ns:=/dark")
    client = make_client(namespace="/dark")
    client.connect(*frame)
    stamp = client.publish(*frame)
    client.result(stamp, "disparity")
    client.diagnosed("pipeline", str(Status.LIT_BY_LAMPS))
    assert not client.has("visibility/attenuation", stamp)
