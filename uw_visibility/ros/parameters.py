# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""ROS parameters: declared from the schema; a change is accepted or refused as a whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from uw_visibility.config.parameters import ParameterInfo, check_names, describe, flatten
from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.errors import InputError, printable
from uw_visibility.optics.spectra import load_response
from uw_visibility.ros.monitor import describe_fault
from uw_visibility.ros.transport.qos import QOS_PREFIX

TYPES = {
    bool: Parameter.Type.BOOL,
    int: Parameter.Type.INTEGER,
    float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
    tuple: Parameter.Type.DOUBLE_ARRAY,
}


@dataclass(frozen=True)
class Settings:
    """Immutable snapshot of all parameters."""

    pipeline: PipelineConfig
    node: NodeConfig

    @classmethod
    def from_values(cls, values: dict[str, Any]) -> Settings:
        """Make settings from values by dotted name.

        Raises `InputError` if a name is unknown, a value is not allowed, or the table of the
        camera's response cannot be loaded.
        """
        settings = cls(PipelineConfig.from_parameters(values), NodeConfig.from_parameters(values))
        load_response(settings.pipeline.camera.response)
        return settings


class NodeParameters:
    """ROS parameters of a node, declared by the constructor; `settings` follows their changes.

    node: its parameter overrides are the initial values.
    settings: replaced as a whole after a change was accepted, so that other threads never see a
        part of a change.
    try_out: called before a change is accepted; raises `InputError` if the settings cannot work.
    told: names of the parameters that were set, at start or later.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.try_out: Callable[[Settings], None] | None = None
        infos = [*describe(PipelineConfig), *describe(NodeConfig)]
        self._infos = {info.name: info for info in infos}
        given = {
            name: parameter.value
            for name, parameter in _overrides(node).items()
            if not name.startswith(QOS_PREFIX) and not node.has_parameter(name)
        }
        self.settings = Settings.from_values(given)
        self.told = set(given)
        self._values = {**flatten(self.settings.pipeline), **flatten(self.settings.node)}
        for info in infos:
            value = self._values[info.name]
            node.declare_parameter(
                info.name,
                list(value) if info.type is tuple else value,
                descriptor(info),
                ignore_override=True,
            )
        node.add_pre_set_parameters_callback(self._convert)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._accept)

    def _convert(self, parameters: list[Parameter]) -> list[Parameter]:
        """Convert integers and texts, which ``ros2 param`` sends, to floats where these belong."""
        return [
            Parameter(p.name, value=self._infos[p.name].numeric(p.value))
            if p.name in self._infos else p
            for p in parameters
        ]

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        mine = self._mine(parameters)
        # While the node starts, most calls concern QoS parameters only.
        if not mine:
            return SetParametersResult(successful=True)
        try:
            settings = Settings.from_values(self._values | mine)
            if self.try_out is not None:
                self.try_out(settings)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        except Exception as error:
            # Any other exception would occur with every frame.
            reason = f"it cannot be used: {printable(error)} ({describe_fault(error)})"
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _accept(self, parameters: list[Parameter]) -> None:
        mine = self._mine(parameters)
        if mine:
            self._values |= mine
            self.told |= set(mine)
            self.settings = Settings.from_values(self._values)

    def _mine(self, parameters: list[Parameter]) -> dict[str, Any]:
        return {p.name: p.value for p in parameters if p.name in self._infos}


def check_qos_overrides(node: Node) -> None:
    """Refuse a ``qos_overrides`` name that no publisher or subscription has read."""
    given = [name for name in _overrides(node) if name.startswith(QOS_PREFIX)]
    known = node.get_parameters_by_prefix(QOS_PREFIX.removesuffix("."))
    check_names(given, [QOS_PREFIX + name for name in known])


def descriptor(info: ParameterInfo) -> ParameterDescriptor:
    """Describe a parameter for ``ros2 param describe``."""
    unit = f" Unit: {info.unit}." if info.unit else ""
    description = ParameterDescriptor(
        name=info.name,
        type=TYPES[info.type].value,
        description=info.description + unit,
        read_only=info.read_only,
    )
    low, high = info.minimum, info.maximum
    if low is not None and high is not None:
        if info.type is int:
            description.integer_range = [
                IntegerRange(from_value=int(low), to_value=int(high), step=1)
            ]
        elif info.type is float:
            description.floating_point_range = [
                FloatingPointRange(from_value=float(low), to_value=float(high), step=0.0)
            ]
        else:
            description.additional_constraints = f"each between {low:g} and {high:g}"
    if info.choices:
        description.additional_constraints = f"one of {', '.join(info.choices)}"
    return description


def _overrides(node: Node) -> dict[str, Parameter]:
    # rclpy has no public way to see values given for names that are not declared.
    overrides: dict[str, Parameter] = node._parameter_overrides
    return overrides
