# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Every type of sensor gives the depth of the camera, positive down."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.errors import InputError
from uw_visibility.messages.depth_sensor import read_depth
from uw_visibility.plausibility.comparison import DepthSample

HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=3, nanosec=7))
STAMP = 3_000_000_007
ARRIVAL = 5_000_000_000


def pose(z: float, variance: float = 0.04) -> SimpleNamespace:
    covariance = [0.0] * 36
    covariance[14] = variance
    position = SimpleNamespace(x=1.0, y=2.0, z=z)
    return SimpleNamespace(
        header=HEADER,
        pose=SimpleNamespace(pose=SimpleNamespace(position=position), covariance=covariance),
    )


def read(message: Any, kind: str, **changes: Any) -> DepthSample:
    return read_depth(message, PlausibilityConfig(sensor_type=kind, **changes), ARRIVAL)


@pytest.mark.parametrize("kind", ["PoseWithCovarianceStamped", "Odometry"])
def test_pose_is_negative_below_the_surface(kind: str) -> None:
    assert read(pose(-4.5), kind) == DepthSample(STAMP, 4.5, 0.04)
    assert read(pose(4.5), kind, sensor_sign="down").depth == 4.5


def test_point_has_no_variance_of_its_own() -> None:
    message = SimpleNamespace(header=HEADER, point=SimpleNamespace(x=0.0, y=0.0, z=-2.0))
    sample = read(message, "PointStamped", sensor_stddev=0.3)
    assert (sample.stamp, sample.depth, sample.variance) == (STAMP, 2.0, pytest.approx(0.09))


def test_number_grows_downwards_and_has_the_time_of_its_arrival() -> None:
    message = SimpleNamespace(data=7.0)
    assert read(message, "Float64").stamp == ARRIVAL
    assert read(message, "Float64").depth == 7.0
    assert read(message, "Float64", sensor_sign="up").depth == -7.0


def test_pressure() -> None:
    message = SimpleNamespace(header=HEADER, fluid_pressure=201325.0, variance=100.0**2)
    sample = read(message, "FluidPressure", sensor_sign="up")
    assert sample.depth == pytest.approx(1e5 / (1025.0 * 9.80665))
    assert math.sqrt(sample.variance) == pytest.approx(100.0 / (1025.0 * 9.80665))
    fresh = read(message, "FluidPressure", density=1000.0, surface_pressure=1e5)
    assert fresh.depth == pytest.approx(101325.0 / 9806.65)
    message.variance = 0.0
    assert read(message, "FluidPressure").variance == pytest.approx(0.01)


# The last ones are of a gauge in air, and of a sensor that is broken.
@pytest.mark.parametrize("value", [1013.25, 1500.0, 21000.0, -20.0, 0.0])
def test_pressure_less_than_that_of_air_is_refused(value: float) -> None:
    message = SimpleNamespace(header=HEADER, fluid_pressure=value, variance=0.0)
    with pytest.raises(InputError, match=r"publish pascals, not mbar"):
        read(message, "FluidPressure")


@pytest.mark.parametrize("offset", [0.0, 500.0])
def test_gauge_has_small_pressures(offset: float) -> None:
    for depth in (0.1, -0.1):
        pressure = offset + depth * 10051.8
        message = SimpleNamespace(header=HEADER, fluid_pressure=pressure, variance=0.0)
        assert read(message, "FluidPressure", surface_pressure=offset).depth == pytest.approx(
            depth, 1e-4)


def test_offset_lies_between_sensor_and_camera() -> None:
    assert read(pose(-4.5), "Odometry", sensor_offset=0.25).depth == 4.75


@pytest.mark.parametrize("variance", [0.0, -1.0, 1e6])
def test_variance_that_states_nothing_is_replaced(variance: float) -> None:
    assert read(pose(-1.0, variance), "Odometry").variance == pytest.approx(0.01)


@pytest.mark.parametrize("variance", [-2.0, -1e-9, math.nan, math.inf, -math.inf])
def test_variance_that_cannot_be_is_refused(variance: float) -> None:
    with pytest.raises(InputError, match="depth_sensor states the variance"):
        read(pose(-1.0, variance), "Odometry")


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e200, 1e308, 12_001.0, -12_001.0])
def test_value_that_no_ocean_has_is_refused(value: float) -> None:
    with pytest.raises(InputError, match="depth_sensor says"):
        read(pose(value), "Odometry")
    with pytest.raises(InputError, match="depth_sensor says"):
        read(SimpleNamespace(data=value), "Float64")
    pressure = SimpleNamespace(header=HEADER, fluid_pressure=value * 1e5, variance=0.0)
    with pytest.raises(InputError, match="depth_sensor says"):
        read(pressure, "FluidPressure")


@pytest.mark.parametrize(("kind", "values"), [
    ("FluidPressure", (1307.55, 1336.98)), ("Float64", (101_325.0, 130_755.0))])
def test_values_of_a_wrong_unit_are_refused_in_one_sentence(
    kind: str, values: tuple[float, ...]
) -> None:
    """Reasons are counted by their text: each value had a line of its own, up to fifty."""
    reasons = set()
    for value in values:
        message = SimpleNamespace(header=HEADER, fluid_pressure=value, variance=0.0, data=value)
        with pytest.raises(InputError) as refused:
            read(message, kind)
        reasons.add(str(refused.value))
    assert len(reasons) == 1


def test_value_without_a_stamp_is_refused() -> None:
    message = pose(-1.0)
    message.header = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0))
    with pytest.raises(InputError, match="depth_sensor has no stamp"):
        read(message, "Odometry")
