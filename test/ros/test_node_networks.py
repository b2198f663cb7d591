# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A node whose network fails goes on without it and says so, until it is given another one."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from graphs import save, shifts

pytest.importorskip("rclpy", reason="ROS is not installed")
pytest.importorskip("onnx", reason="onnx is not installed")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from onnx import helper
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter

NAMESPACE = "/networks"


def test_the_built_in_matcher_stands_in_for_a_network_that_fails(
    start_node: Callable[..., Any], make_client: Callable[..., Any], parts: Any, tmp_path: Path
) -> None:
    bad = save(tmp_path / "bad.onnx", [
        helper.make_node("ReduceMean", ["left"], ["mean"], axes=[1]),
        helper.make_node("Sub", ["mean", "mean"], ["none"]),
        helper.make_node("Div", ["none", "none"], ["disparity"])])
    good = shifts(tmp_path / "good.onnx", 40)
    start_node(
        "-r", f"__ns:={NAMESPACE}", "-p", "stereo.max_disparity:=40",
        "-p", "stereo.matcher:=onnx", "-p", f"stereo.model:={bad}")
    client = make_client(namespace=NAMESPACE)
    # It publishes pairs until one is answered.
    client.connect(*parts)
    client.result(client.publish(*parts), "disparity")
    status = client.diagnosed("pipeline", "built-in matcher and restorer stand in")
    assert status.level == DiagnosticStatus.ERROR
    assert "bad.onnx gave" in status.message
    assert int(status.numbers["frames failed"]) == 3
    request = SetParametersAtomically.Request(
        parameters=[Parameter("stereo.model", value=str(good)).to_parameter_msg()])
    assert client.call("uw_visibility/set_parameters_atomically", request).result.successful
    client.result(client.publish(*parts), "disparity")
    digest = hashlib.sha256(good.read_bytes()).hexdigest()
    client.wait(
        lambda: client.diagnosis("pipeline").numbers["stereo.model_sha256"] == digest,
        "the other network's digest")
    client.wait(
        lambda: client.diagnosis("pipeline").level == DiagnosticStatus.OK, "recovery")
    # A model that cannot be loaded changes nothing.
    request.parameters[0].value.string_value = str(tmp_path / "none.onnx")
    refused = client.call("uw_visibility/set_parameters_atomically", request).result
    assert not refused.successful
    assert "cannot read model" in refused.reason
    client.result(client.publish(*parts), "disparity")
