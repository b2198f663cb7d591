# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Rows wait for the sensors around them, and not for ever."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from frame_records import frame_estimate, frame_record
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import chdtri

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.errors import InputError
from uw_visibility.messages.stamps import iso_time
from uw_visibility.plausibility.comparison import Comparison, DepthSample, Verdict
from uw_visibility.replay.columns import COLUMNS
from uw_visibility.replay.inputs.sensors import (
    LONGEST_GAP,
    Position,
    ScalarTopic,
    ScalarValue,
    geographic,
    read_position,
)
from uw_visibility.replay.inputs.stream import Restart, SensorValue
from uw_visibility.replay.records import FrameRecord, JoinedFrame
from uw_visibility.replay.results.exports import write_geojson
from uw_visibility.replay.results.joining import MOST_WAITING, Joiner
from uw_visibility.replay.table import TableWriter, read_table
from uw_visibility.status import Status
from uw_visibility.water.estimate import LampLight
from uw_visibility.water.series.filter import FilteredWater
from uw_visibility.water.series.tracking import TrackingEvent

CONFIG = PlausibilityConfig(sensor_type="Float64", model_stddev=0.3, max_gate=3.0)


def record(time: float, depth: float | None = 3.0) -> FrameRecord:
    estimate = frame_estimate(depth_status=Status.SATURATED) if depth is None else frame_estimate(
        depth=depth, depth_stddev=0.6, depth_precision=0.4)
    return frame_record(time, estimate=estimate)


def sensor(time: float, depth: float) -> SensorValue:
    stamp = round(time * 1e9)
    return SensorValue(DepthSample(stamp, depth, 0.0), stamp)


def depth_of(joined: JoinedFrame) -> float:
    assert joined.sensor is not None
    return joined.sensor.depth


def comparison_of(joined: JoinedFrame) -> Comparison:
    assert joined.comparison is not None
    return joined.comparison


def test_a_row_waits_for_the_sensor_and_takes_its_value_in_between() -> None:
    joiner = Joiner(CONFIG)
    assert list(joiner.add(sensor(1.0, 2.0))) == []
    assert list(joiner.add_frame(record(1.5))) == []
    (joined,) = joiner.add(sensor(2.0, 4.0))
    assert depth_of(joined) == 3.0
    assert comparison_of(joined).innovation == 0.0
    (joined,) = list(joiner.add_frame(record(2.0)))
    comparison = comparison_of(joined)
    assert comparison.innovation == pytest.approx(1.0)
    # A metre between two frames half a second apart is more than estimate and model leave open.
    assert 0.0 < comparison.variance < 1.0 / chdtri(1.0, 0.05)
    assert comparison.nis == pytest.approx(comparison.innovation**2 / comparison.variance)
    assert joined.verdict is Verdict.OK


def test_a_refused_depth_has_the_sensor_beside_it_but_no_nis() -> None:
    joiner = Joiner(CONFIG)
    list(joiner.add(sensor(1.0, 2.0)))
    (joined,) = joiner.add_frame(record(1.0, None))
    assert depth_of(joined) == 2.0
    assert joined.comparison is None
    assert joined.verdict is Verdict.NOT_ASSESSABLE
    assert joined.verdict_reason == "the depth is not assessable: saturated"


def test_a_frame_without_result_is_not_judged_and_its_neighbours_are() -> None:
    joiner = Joiner(CONFIG)
    failed = frame_record(1.5, 1, reason="left image: too dark")
    out = [*joiner.add(sensor(0.9, 2.0)), *joiner.add_frame(record(1.0))]
    # The next frame is there before the sensor's next value.
    out += [*joiner.add_frame(failed), *joiner.add(sensor(2.0, 2.0))]
    assert [(str(j.verdict), j.verdict_reason) for j in out] == [
        ("ok", ""), ("not assessable", "the frame has no result")]
    assert depth_of(out[1]) == 2.0


def test_a_sensor_that_is_silent_holds_no_row_up() -> None:
    joiner = Joiner(CONFIG)
    out = [r for k in range(10) for r in joiner.add_frame(record(1.0 + k))]
    out += joiner.finish()
    assert [j.record.stamp for j in out] == [10**9 * (1 + k) for k in range(10)]
    assert all(j.sensor is None for j in out)
    assert len(list(Joiner(replace(CONFIG, sensor_type="none")).add_frame(record(1.0)))) == 1


def test_a_frame_waits_for_a_fix_as_long_as_positions_are_interpolated() -> None:
    """At 20 frames a second, between two fixes nearly as far apart as is interpolated."""
    joiner = Joiner(replace(CONFIG, sensor_type="none"), True)
    list(joiner.add(Position(1_000_000_000, False, 0.0, 0.0)))
    times = np.arange(1.0, 1.0 + LONGEST_GAP - 0.5, 0.05)
    out = [r for time in times for r in joiner.add_frame(record(time))]
    out += joiner.add(Position(round((0.8 + LONGEST_GAP) * 1e9), False, LONGEST_GAP - 0.2, 0.0))
    assert [j.x for j in out] == pytest.approx(times - 1.0)
    assert joiner.unplaced == 0


def test_a_frame_waits_for_a_joined_value_as_long_as_is_tolerated() -> None:
    ctd = ScalarTopic("/ctd")
    joiner = Joiner(replace(CONFIG, sensor_type="none"), joins=[ctd], tolerance=600.0)
    list(joiner.add(ScalarValue(ctd, 0, 0.0)))
    times = np.arange(0.0, 600.0)
    out = [r for time in times for r in joiner.add_frame(record(time))]
    out += joiner.add(ScalarValue(ctd, 600_000_000_000, 600.0))
    assert [j.scalars[0] for j in out] == pytest.approx(times)


def test_frames_that_wait_are_limited_and_have_no_observations() -> None:
    ctd = ScalarTopic("/ctd")
    joiner = Joiner(replace(CONFIG, sensor_type="none"), joins=[ctd], tolerance=3600.0)
    full = record(0.0)
    assert full.estimate is not None
    lamps = LampLight(*(np.ones(3) for _ in range(5)))
    water = replace(full.estimate.water, lamps=lamps)
    full = replace(full, estimate=replace(full.estimate, water=water))
    filtered = FilteredWater(
        water, full.estimate.visibility, TrackingEvent.UPDATED)
    out = [r for _ in range(MOST_WAITING) for r in joiner.add_frame(full, filtered)]
    (joined,) = out
    assert joined.record.estimate is not None
    assert joined.filtered is not None
    assert joined.record.estimate.water.lamps is None
    assert joined.filtered.water.lamps is None


def test_what_else_is_joined_does_not_change_the_verdicts() -> None:
    """The depth sensor falls silent; the fixes and another sensor go on."""
    ctd = ScalarTopic("/ctd")
    alone, beside = Joiner(CONFIG), Joiner(CONFIG, True, joins=[ctd], tolerance=60.0)
    verdicts = []
    for joiner, other in ((alone, False), (beside, True)):
        out = []
        for k in range(60):
            time = 100.0 + 0.5 * k
            if k < 30:
                out += joiner.add(sensor(time, 3.0))
            if other and k % 15 == 0:
                out += joiner.add(Position(round(time * 1e9), False, 0.0, 0.0))
                out += joiner.add(ScalarValue(ctd, round(time * 1e9), 1.0))
            out += joiner.add_frame(record(time))
        out += joiner.finish()
        verdicts.append([(j.record.stamp, j.verdict, j.verdict_reason) for j in out])
    assert verdicts[0] == verdicts[1]
    assert [verdict for _, verdict, _ in verdicts[0]] == [Verdict.OK] * 30 + [Verdict.STALE] * 30


def test_across_a_gap_of_the_sensor_nothing_is_made_up() -> None:
    joiner = Joiner(CONFIG)
    list(joiner.add(sensor(1.0, 2.0)))
    list(joiner.add_frame(record(2.0)))
    (joined,) = joiner.add(sensor(1.1 + CONFIG.timeout, 2.0))
    assert joined.sensor is None


def test_a_restart_forgets_the_learned_bias() -> None:
    joiner = Joiner(CONFIG)
    for begin in (100.0, 50.0):
        for k in range(4):
            (joined,) = [*joiner.add(sensor(begin + k, 5.0)),
                         *joiner.add_frame(record(begin + k))]
            expected = 2.0 - comparison_of(joined).innovation
            assert expected == 0.0 if k == 0 else expected > 0.1
        list(joiner.add(Restart()))


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("jump", [3600.0, -3600.0])
def test_a_wrong_stamp_costs_no_other_frame_its_values(jump: float, restart: bool) -> None:
    joiner = Joiner(CONFIG, True)
    out = []
    for k in range(40):
        time = 100.0 + 0.5 * k
        if restart and k == (11 if jump > 0.0 else 10):
            out += joiner.add(Restart())
        out += joiner.add_frame(record(time + jump * (k == 10)))
        # Frames are received later than fixes of their stamp, and before such values of the sensor.
        out += joiner.add(sensor(time + 0.3, 3.0))
        out += joiner.add(Position(round((time + 1.3) * 1e9), False, k, 0.0))
    out += joiner.finish()
    # Nothing is before the first frames.
    assert [k for k, j in enumerate(out) if j.sensor is None] == [0, 10]
    assert [k for k, j in enumerate(out) if np.isnan(j.x)] == [0, 1, 2, 10]


def test_a_wrong_stamp_that_is_reached_later_costs_no_other_frame_its_values() -> None:
    """It came after the restart, as a pair does that waited for its CameraInfo."""
    joiner = Joiner(replace(CONFIG, sensor_type="none"), True)
    times = [100.0, 100.5, 105.0, *np.arange(101.5, 110.0, 0.5)]
    out = []
    list(joiner.add(Position(100_000_000_000, False, 100.0, 0.0)))
    for time in times:
        out += joiner.add_frame(record(time))
        if time != 105.0:
            out += joiner.add(Position(round((time + 0.4) * 1e9), False, time + 0.4, 0.0))
    out += joiner.finish()
    assert [j.x for j in out] == pytest.approx(times)


def test_a_clock_that_is_set_back_costs_the_frames_around_alone() -> None:
    joiner = Joiner(CONFIG, True)
    out = []
    for k in range(40):
        time = 100.0 + 0.5 * k - 60.0 * (k >= 20)
        if k == 20:
            out += joiner.add(Restart())
        out += joiner.add_frame(record(time))
        out += joiner.add(sensor(time + 0.3, 3.0))
        out += joiner.add(Position(round((time + 0.3) * 1e9), False, k, 0.0))
    out += joiner.finish()
    assert [k for k, j in enumerate(out) if j.sensor is None or np.isnan(j.x)] == [0, 20]


def test_values_after_a_restart_are_of_no_frame_before() -> None:
    """All clocks are set back by less than a frame waits for a fix."""
    joiner = Joiner(replace(CONFIG, sensor_type="none"), True)
    list(joiner.add(Position(100_000_000_000, False, 0.0, 0.0)))
    assert list(joiner.add_frame(record(103.0))) == []
    (before,) = joiner.add(Restart())
    assert np.isnan(before.x)


@given(st.lists(st.booleans(), min_size=1, max_size=30), st.integers(0, 3))
def test_every_row_comes_out_once_and_in_order(frames: list[bool], restart: int) -> None:
    joiner = Joiner(CONFIG, position=True)
    out, stamps = [], []
    for k, is_frame in enumerate(frames):
        time = 100.0 + 0.4 * k - 50.0 * (k // 10 if restart == 0 else 0)
        if is_frame:
            stamps.append(round(time * 1e9))
            out += joiner.add_frame(record(time))
        else:
            out += joiner.add(sensor(time, 1.0))
            out += joiner.add(Position(round(time * 1e9), False, 0.0, 0.0))
    out += joiner.finish()
    assert [j.record.stamp for j in out] == stamps


def test_positions_are_interpolated_and_become_longitude_and_latitude() -> None:
    joiner = Joiner(replace(CONFIG, sensor_type="none"), True, origin=(60.0, 10.0))
    list(joiner.add(Position(1_000_000_000, False, 0.0, 0.0)))
    assert list(joiner.add_frame(record(2.0))) == []
    (joined,) = joiner.add(Position(3_000_000_000, False, 200.0, 400.0))
    assert (joined.x, joined.y) == (100.0, 200.0)
    # A degree of latitude is 111.2 km; one of longitude half as much at 60 degrees north.
    assert joined.latitude == pytest.approx(60.0 + 0.2 / 111.195, abs=1e-6)
    assert joined.longitude == pytest.approx(10.0 + 0.1 / 55.597, abs=1e-6)
    assert geographic(0.0, 0.0, (60.0, 10.0)) == (10.0, 60.0)


@pytest.mark.parametrize("late", [2_000_000_000, 1_500_000_000])
def test_a_position_out_of_order_is_left_out_and_costs_no_other(late: int) -> None:
    """One of the same stamp as the last, and one half a second older."""
    joiner = Joiner(replace(CONFIG, sensor_type="none"), True)
    for stamp, x in ((1_000_000_000, 0.0), (2_000_000_000, 100.0), (late, 900.0)):
        list(joiner.add(Position(stamp, False, x, 0.0)))
    first, second = (next(joiner.add_frame(record(time))) for time in (1.25, 1.75))
    assert (first.x, second.x) == (25.0, 75.0)


def test_positions_that_go_back_by_more_than_a_second_begin_anew() -> None:
    joiner = Joiner(replace(CONFIG, sensor_type="none"), True)
    for stamp, x in ((8_000_000_000, 700.0), (9_000_000_000, 800.0), (1_000_000_000, 0.0)):
        list(joiner.add(Position(stamp, False, x, 0.0)))
    list(joiner.add(Position(2_000_000_000, False, 100.0, 0.0)))
    (joined,) = joiner.add_frame(record(1.5))
    assert joined.x == 50.0


def fix(latitude: float, longitude: float, status: int = 0) -> SimpleNamespace:
    header = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=5))
    return SimpleNamespace(
        header=header, status=SimpleNamespace(status=status), latitude=latitude,
        longitude=longitude, altitude=0.0)


def test_a_fix_is_read_and_none_where_there_is_none() -> None:
    assert read_position(fix(1.0, 2.0)) == Position(1_000_000_005, True, 2.0, 1.0)
    assert read_position(fix(1.0, 2.0, status=-1)) is None
    assert read_position(fix(float("nan"), 2.0)) is None


@pytest.mark.parametrize("step", [0.004, -0.004])
def test_positions_across_the_date_line_stay_there(step: float) -> None:
    joiner = Joiner(replace(CONFIG, sensor_type="none"), True)
    side = np.sign(step)
    before, beyond = side * (180.0 - abs(step) / 2), -side * (180.0 - abs(step) / 2)
    list(joiner.add(Position(1_000_000_000, True, before, 10.0)))
    assert list(joiner.add_frame(record(2.5))) == []
    (joined,) = joiner.add(Position(3_000_000_000, True, beyond, 10.0))
    # Three quarters of the way, a quarter beyond the line.
    assert joined.longitude == pytest.approx(-side * 179.999, abs=1e-9)
    assert geographic(2000.0, 0.0, (0.0, 179.99))[0] == pytest.approx(-179.992, abs=1e-3)


@pytest.mark.parametrize(("latitude", "longitude"), [(100.0, 2.0), (1.0, 3.7e7)])
def test_a_fix_that_is_nowhere_on_earth_is_refused(latitude: float, longitude: float) -> None:
    with pytest.raises(InputError, match="publish degrees"):
        read_position(fix(latitude, longitude))


def test_longitudes_from_0_to_360_are_those_of_wgs_84() -> None:
    position = read_position(fix(1.0, 350.0))
    assert position is not None
    assert position.x == -10.0


def test_geojson_has_a_point_for_each_frame_with_a_position(tmp_path: Path) -> None:
    writer = TableWriter(tmp_path / "frames.csv", tuple(COLUMNS))
    columns = {"frame": 7, "datetime": iso_time(0)}
    for row in (
        {"longitude": "10.5", "latitude": "60.25", "status": "ok", "depth": "3.5"},
        {"status": "ok"},
        {"longitude": "10.6", "latitude": "60.25", "status": "saturated"},
    ):
        writer.write({**columns, **row})
    writer.close()
    write_geojson(tmp_path / "f.geojson", read_table(tmp_path / "frames.csv", COLUMNS))
    features = json.loads((tmp_path / "f.geojson").read_text())["features"]
    assert [f["geometry"]["coordinates"] for f in features] == [[10.5, 60.25], [10.6, 60.25]]
    assert features[0]["properties"]["depth"] == 3.5
    assert features[0]["properties"]["frame"] == 7
    assert features[1]["properties"]["depth"] is None
