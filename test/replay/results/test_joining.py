# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Rows wait for the sensors around them, and not for ever."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.plausibility.samples import DepthSample
from uw_visibility.replay.inputs.positions import (
    PROPERTIES,
    Position,
    geographic,
    read_position,
    write_geojson,
)
from uw_visibility.replay.inputs.stream import SensorValue
from uw_visibility.replay.results.joining import Joiner
from uw_visibility.replay.table import FAILED, nanoseconds, number, seconds

CONFIG = PlausibilityConfig(sensor_type="Float64", model_stddev=0.3, max_gate=3.0)


def row(time: float, depth: float | None = 3.0) -> dict[str, str]:
    stamp = seconds(round(time * 1e9))
    known = {} if depth is None else {
        "depth": number(depth), "depth_stddev": "0.6", "depth_precision": "0.4",
    }
    return {
        "frame": "0", "stamp": stamp, "time": stamp, "status": "ok", "reason": "",
        "depth_status": "ok" if known else "saturated",
        "depth": "", "depth_stddev": "", "depth_precision": "", **known,
    }


def sensor(time: float, depth: float) -> SensorValue:
    stamp = round(time * 1e9)
    return SensorValue(DepthSample(stamp, depth, 0.0), stamp)


def test_a_row_waits_for_the_sensor_and_takes_its_value_in_between() -> None:
    joiner = Joiner(CONFIG)
    assert list(joiner.add_sensor(sensor(1.0, 2.0))) == []
    assert list(joiner.add_frame(row(1.5))) == []
    (joined,) = joiner.add_sensor(sensor(2.0, 4.0))
    assert float(joined["sensor_depth"]) == 3.0
    assert float(joined["innovation"]) == 0.0
    (joined,) = list(joiner.add_frame(row(2.0)))
    assert float(joined["innovation"]) == 1.0
    # S is the sum of what estimate, sensor and model are uncertain by.
    assert float(joined["nis"]) == pytest.approx(1.0 / (0.4**2 + 0.3**2))
    assert joined["plausibility"] == "ok"


def test_a_refused_depth_has_the_sensor_beside_it_but_no_nis() -> None:
    joiner = Joiner(CONFIG)
    list(joiner.add_sensor(sensor(1.0, 2.0)))
    (joined,) = joiner.add_frame(row(1.0, None))
    assert float(joined["sensor_depth"]) == 2.0
    assert "nis" not in joined
    assert joined["plausibility"] == "not assessable"
    assert joined["plausibility_reason"] == "the depth is not assessable: saturated"


def test_a_frame_without_result_is_not_judged_and_its_neighbours_are() -> None:
    joiner = Joiner(CONFIG)
    failed = {"frame": "1", "stamp": seconds(1_500_000_000), "time": seconds(1_500_000_000),
              "status": FAILED, "reason": "left image: too dark"}
    out = [*joiner.add_sensor(sensor(0.9, 2.0)), *joiner.add_frame(row(1.0))]
    # The next frame is there before the sensor's next value.
    out += [*joiner.add_frame(failed), *joiner.add_sensor(sensor(2.0, 2.0))]
    assert [(r["plausibility"], r["plausibility_reason"]) for r in out] == [
        ("ok", ""), ("not assessable", "the frame has no result")]
    assert float(out[1]["sensor_depth"]) == 2.0


def test_a_sensor_that_is_silent_holds_no_row_up() -> None:
    joiner = Joiner(CONFIG)
    out = [r for k in range(10) for r in joiner.add_frame(row(1.0 + k))]
    out += joiner.finish()
    assert [nanoseconds(r["stamp"]) for r in out] == [10**9 * (1 + k) for k in range(10)]
    assert all("sensor_depth" not in r for r in out)
    assert len(list(Joiner(replace(CONFIG, sensor_type="none")).add_frame(row(1.0)))) == 1


def test_across_a_gap_of_the_sensor_nothing_is_made_up() -> None:
    joiner = Joiner(CONFIG)
    list(joiner.add_sensor(sensor(1.0, 2.0)))
    list(joiner.add_frame(row(2.0)))
    (joined,) = joiner.add_sensor(sensor(1.1 + CONFIG.timeout, 2.0))
    assert "sensor_depth" not in joined


def test_a_restart_forgets_the_learned_bias_but_not_what_was_counted() -> None:
    joiner = Joiner(replace(CONFIG, bias_window=2))
    for begin in (100.0, 50.0):
        for k in range(4):
            (joined,) = [*joiner.add_sensor(sensor(begin + k, 5.0)),
                         *joiner.add_frame(row(begin + k))]
            learned = k >= 2
            assert float(joined["innovation"]) == (0.0 if learned else 2.0)
            assert joined["plausibility"] == ("ok" if k >= 1 else "learning")
        assert (report := joiner.report()) is not None
        assert report.compared == (4 if begin == 100.0 else 8)
        joiner.restart()


@given(st.lists(st.booleans(), min_size=1, max_size=30), st.integers(0, 3))
def test_every_row_comes_out_once_and_in_order(frames: list[bool], restart: int) -> None:
    joiner = Joiner(CONFIG, position=True)
    out, stamps = [], []
    for k, is_frame in enumerate(frames):
        time = 100.0 + 0.4 * k - 50.0 * (k // 10 if restart == 0 else 0)
        if is_frame:
            stamps.append(round(time * 1e9))
            out += joiner.add_frame(row(time))
        else:
            out += joiner.add_sensor(sensor(time, 1.0))
            out += joiner.add_position(Position(round(time * 1e9), False, 0.0, 0.0, 0.0))
    out += joiner.finish()
    assert [nanoseconds(r["stamp"]) for r in out] == stamps


def test_positions_are_interpolated_and_become_longitude_and_latitude() -> None:
    joiner = Joiner(replace(CONFIG, sensor_type="none"), True, origin=(60.0, 10.0))
    list(joiner.add_position(Position(1_000_000_000, False, 0.0, 0.0, 0.0)))
    assert list(joiner.add_frame(row(2.0))) == []
    (joined,) = joiner.add_position(Position(3_000_000_000, False, 200.0, 400.0, 0.0))
    assert (float(joined["x"]), float(joined["y"])) == (100.0, 200.0)
    # A degree of latitude is 111.2 km; one of longitude half as much at 60 degrees north.
    assert float(joined["latitude"]) == pytest.approx(60.0 + 0.2 / 111.195, abs=1e-6)
    assert float(joined["longitude"]) == pytest.approx(10.0 + 0.1 / 55.597, abs=1e-6)
    assert geographic(0.0, 0.0, (60.0, 10.0)) == (10.0, 60.0)


def test_a_fix_is_read_and_none_where_there_is_none() -> None:
    header = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=5))
    fix = SimpleNamespace(
        header=header, status=SimpleNamespace(status=0), latitude=1.0, longitude=2.0, altitude=0.0
    )
    assert read_position(fix) == Position(1_000_000_005, True, 2.0, 1.0, 0.0)
    fix.status.status = -1
    assert read_position(fix) is None
    fix.status.status, fix.latitude = 0, float("nan")
    assert read_position(fix) is None


def test_geojson_has_a_point_for_each_frame_with_a_position(tmp_path: Path) -> None:
    columns = {**dict.fromkeys((*PROPERTIES, "stamp", "longitude", "latitude"), ""), "frame": "7"}
    rows = [
        {**columns, "longitude": "10.5", "latitude": "60.25", "status": "ok", "depth": "3.5"},
        {**columns, "status": "ok"},
        {**columns, "longitude": "10.6", "latitude": "60.25", "status": "saturated"},
    ]
    assert write_geojson(tmp_path / "f.geojson", iter(rows)) == 2
    features = json.loads((tmp_path / "f.geojson").read_text())["features"]
    assert [f["geometry"]["coordinates"] for f in features] == [[10.5, 60.25], [10.6, 60.25]]
    assert features[0]["properties"]["depth"] == 3.5
    assert features[0]["properties"]["frame"] == 7
    assert features[1]["properties"]["depth"] is None
