# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the running node: described, changed all or none, refused with the reason."""

from __future__ import annotations

import array
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from uw_visibility.config.parameters import ROS_PARAMETERS, describe
from uw_visibility.config.schema import NodeConfig, PipelineConfig

pytest.importorskip("rclpy", reason="ROS is not installed")

from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
)
from rclpy.parameter import Parameter, parameter_dict_from_yaml_file, parameter_value_to_python
from type_description_interfaces.srv import GetTypeDescription

INFOS = {info.name: info for info in [*describe(PipelineConfig), *describe(NodeConfig)]}


@pytest.fixture(scope="module")
def client(start_node: Callable[..., Any], make_client: Callable[..., Any]) -> Any:
    start_node("-r", "__ns:=/parameters")
    return make_client(namespace="/parameters")


def get(client: Any, *names: str) -> list[Any]:
    request = GetParameters.Request(names=list(names))
    values = client.call("uw_visibility/get_parameters", request).values
    return [parameter_value_to_python(value) for value in values]


def test_every_parameter_is_there_and_described(client: Any) -> None:
    listed = client.call("uw_visibility/list_parameters", ListParameters.Request()).result.names
    assert set(INFOS) <= set(listed)
    request = DescribeParameters.Request(names=list(INFOS))
    for described in client.call("uw_visibility/describe_parameters", request).descriptors:
        info = INFOS[described.name]
        assert info.description in described.description
        assert described.read_only == info.read_only
        if info.type in (int, float) and info.minimum is not None and info.maximum is not None:
            (limits,) = [*described.integer_range, *described.floating_point_range]
            assert (limits.from_value, limits.to_value) == (info.minimum, info.maximum)
        for choice in info.choices:
            assert choice in described.additional_constraints


def test_every_topic_has_qos_overrides(client: Any) -> None:
    listed = client.call("uw_visibility/list_parameters", ListParameters.Request()).result.names
    for topic in ("disparity.publisher", "left/image_rect.subscription"):
        assert f"qos_overrides./parameters/{topic}.reliability" in listed


def test_types_of_its_topics_are_described(client: Any) -> None:
    client.wait(lambda: client.node.count_publishers("disparity") == 1, "a publisher")
    (publisher,) = client.node.get_publishers_info_by_topic("disparity")
    request = GetTypeDescription.Request(
        type_name=publisher.topic_type, type_hash=str(publisher.topic_type_hash)
    )
    answer = client.call("uw_visibility/get_type_description", request)
    assert answer.successful, answer.failure_reason
    described = answer.type_description.type_description
    assert described.type_name == "stereo_msgs/msg/DisparityImage"
    assert {"f", "t", "min_disparity"} <= {field.name for field in described.fields}


def test_values_are_those_of_the_configuration(client: Any) -> None:
    names = [name for name in INFOS if name != "max_range"]
    defaults = [INFOS[name].default for name in names]
    values = [tuple(v) if hasattr(v, "tolist") or isinstance(v, list) else v
              for v in get(client, *names)]
    assert values == defaults


@pytest.mark.parametrize(("values", "reason"), [
    ({"camera__transfer": "gamma"}, "camera.transfer is 'gamma': give one of linear, srgb"),
    ({"camera__response": "/no/such.csv"}, "/no/such.csv"),
    ({"rectify": True}, "read-only"),
    ({"camera__white_reference": [1.0, 2.0]}, "give 3 numbers"),
    ({"max_range": "far"}, "expected 'Type.DOUBLE'"),
    ({"synchronization__tolerance": -1.0}, "synchronization.tolerance"),
    ({"camera__flat_field": "/none.png"}, "camera.flat_field: cannot read"),
    ({"camera__flat_field": "/dev/zero"}, "camera.flat_field: image /dev/zero"),
    ({"camera__flat_field_right": "/none.png"}, "camera.flat_field: cannot read"),
    ({"camera__response": "/dev/zero"}, "/dev/zero"),
    ({"stereo__min_disparity": 90, "stereo__max_disparity": 96}, "leave at least 8 px"),
    ({"depth_frame": ""}, "parameter depth_frame is ''"),
    ({"depth_frame": "/map"}, "parameter depth_frame is '/map'"),
    ({"depth_frame": "a map"}, "parameter depth_frame is 'a map'"),
])
def test_refused_change_says_why_and_changes_nothing(
    client: Any, values: dict[str, Any], reason: str
) -> None:
    before = get(client, "assessment.contrast")
    result = client.set_parameters(assessment__contrast=0.1, **values)
    assert not result.successful
    assert reason in result.reason
    assert get(client, "assessment.contrast") == before


def test_whole_number_stands_for_a_decimal_one(client: Any) -> None:
    assert client.set_parameters(max_range=30).successful
    assert get(client, "max_range") == [30.0]


def test_a_dump_of_the_node_loads_again(client: Any, tmp_path: Path) -> None:
    """As ``ros2 param dump`` writes it and ``ros2 param load`` reads and sends it."""
    assert client.set_parameters(camera__vignetting=[1e-05, -2e-07, 0.0], tracking__light_rate=1e-4
                  ).successful
    listed = client.call("uw_visibility/list_parameters", ListParameters.Request()).result.names
    values = dict(zip(listed, get(client, *listed), strict=True))
    values = {name: list(v) if isinstance(v, array.array) else v for name, v in values.items()}
    file = tmp_path / "dump.yaml"
    file.write_text(yaml.dump({"/parameters/uw_visibility": {"ros__parameters": values}}))
    loaded = parameter_dict_from_yaml_file(str(file))
    request = SetParameters.Request(parameters=list(loaded.values()))
    results = client.call("uw_visibility/set_parameters", request).results
    refused = {
        name: result.reason for name, result in zip(loaded, results, strict=True)
        if not result.successful and "read-only" not in result.reason
        and not name.startswith(ROS_PARAMETERS)}
    assert refused == {}
    assert dict(zip(listed, get(client, *listed), strict=True)) | values == values


def test_changes_that_are_not_atomic_are_judged_one_by_one(client: Any) -> None:
    # As ros2 param load sends them.
    values = {"assessment.contrast": 0.04, "camera.transfer": "gamma", "max_range": 25.0}
    parameters = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
    request = SetParameters.Request(parameters=parameters)
    results = client.call("uw_visibility/set_parameters", request).results
    assert [result.successful for result in results] == [True, False, True]
    assert "give one of linear, srgb" in results[1].reason
    assert get(client, *values) == [0.04, "linear", 25.0]


def test_change_holds_from_the_next_frame(client: Any, parts: Any) -> None:
    client.connect(*parts)
    assert client.set_parameters(max_range=100.0, assessment__contrast=0.05).successful
    before = client.result(client.publish(*parts), "visibility/distance")[0]
    assert client.set_parameters(assessment__contrast=0.2).successful
    after = client.result(client.publish(*parts), "visibility/distance")[0]
    expected = math.log(0.8 / 0.4 + 1) / math.log(0.95 / 0.1 + 1)
    assert after.range / before.range == pytest.approx(expected, rel=1e-3)
    assert client.set_parameters(max_range=0.5).successful
    beyond = client.result(client.publish(*parts), "visibility/distance")[0]
    assert (beyond.range, beyond.max_range) == (math.inf, 0.5)


def test_change_that_no_image_of_the_size_in_use_allows_is_refused(
    client: Any, parts: Any, tmp_path: Path
) -> None:
    client.result(client.publish(*parts), "disparity")
    field = tmp_path / "flat.png"
    cv2.imwrite(str(field), np.full((100, 100, 3), 200, np.uint8))
    for values, reason in (
        ({"stereo__min_disparity": 120}, "stereo.min_disparity is 120"),
        ({"camera__flat_field": str(field)}, "the flat field has 100x100 px and the image 160x120"),
        ({"max_megapixels": 0.01}, "images have 160x120 pixels, more than max_megapixels"),
    ):
        result = client.set_parameters(**values)
        assert (result.successful, reason in result.reason) == (False, True), result.reason
    client.result(client.publish(*parts), "disparity")
