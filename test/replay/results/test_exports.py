# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Table, NetCDF, Parquet, GeoJSON and messages of one replay, each by another's reader."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import sys
import tracemalloc
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_copies import FRAMES, Message, copy_bag, copy_bag_ros1, fix, run
from rosbags.typesys import Stores, get_typestore

from uw_visibility.messages.stamps import iso_time, seconds
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.columns import COLUMNS, FAILED, Column, joined_column
from uw_visibility.replay.line_fit import LineFit
from uw_visibility.replay.results.exports import write_netcdf
from uw_visibility.replay.table import SUFFIX, TableWriter, read_rows, read_table
from uw_visibility.status import Status

LAST_FIX = FRAMES - 2
"""Frames with a position."""
TEMPERATURE = "joined_ctd_temperature"


def with_sensors(messages: Iterator[Message]) -> Iterator[Message]:
    """Add fixes, which end early, a thermometer and a transmissometer without stamps."""
    types = get_typestore(Stores.ROS2_JAZZY).types
    frame = 0
    for message in messages:
        yield message
        if message[0] != "/depth_sensor":
            continue
        header, time = message[2].header, message[3]
        yield "/ctd", "sensor_msgs/msg/Temperature", types["sensor_msgs/msg/Temperature"](
            header=header, temperature=8.0 + 0.5 * frame, variance=0.0), time
        yield "/c", "std_msgs/msg/Float32", types["std_msgs/msg/Float32"](
            data=0.2 + 0.02 * frame), time
        if frame < LAST_FIX:
            yield fix(message, 59.5, 10.5 + 1e-5 * frame)
        frame += 1


@pytest.fixture(scope="module")
def exported(transect: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A replay with everything that can be written."""
    folder = tmp_path_factory.mktemp("exported")
    bag = copy_bag(transect, folder / "bag", edit=with_sensors)
    pytest.importorskip("xarray", reason="the extra netcdf is not installed")
    pytest.importorskip("netCDF4", reason="the extra netcdf is not installed")
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    options = ["--netcdf", "--parquet", "--geo", "/fix", "--join", "/ctd.temperature=degC",
               "--join", "/c=m-1", "--attribute", "license=CC-BY-4.0",
               "--attribute", "institution=Institute of x=y"]
    with pytest.MonkeyPatch.context() as patch:
        # The series of `replayed` are drawn.
        patch.setattr("uw_visibility.replay.report.report.draw_series", lambda *_: [])
        assert run(bag, folder / "out", *options).code == 0
    return folder / "out"


@pytest.fixture(scope="module")
def rows(exported: Path) -> list[dict[str, str]]:
    return list(read_rows(exported / "frames.csv"))


def test_table_has_iso_times_and_joined_values(rows: list[dict[str, str]]) -> None:
    assert rows[1]["datetime"] == "2023-11-14T22:13:20.500000000Z"
    assert [float(row[TEMPERATURE]) for row in rows] == [8.0 + 0.5 * k for k in range(FRAMES)]
    # A message without a header has the time at which it was received.
    np.testing.assert_allclose(
        [float(row["joined_c"]) for row in rows], [0.2 + 0.02 * k for k in range(FRAMES)])
    for row in rows:
        assert float(row["black_disc_visibility"]) == pytest.approx(
            4.8 / (2.0 * float(row["attenuation_green"])))
        # Between two types none is told.
        assert row["water_type"] in ("II", "III", "1C", "")
        # Where two types are as probable, Secchi depth and Kd are between theirs.
        depth, stddev = (
            float(row[f"filtered_secchi_depth{end}"]) for end in ("", "_stddev"))
        assert 5.0 < depth < 30.0 and 0.2 * depth < stddev < depth


def test_dictionary_describes_every_column(exported: Path, rows: list[dict[str, str]]) -> None:
    content = json.loads((exported / f"frames.csv{SUFFIX}").read_text())
    assert content["url"] == "frames.csv"
    columns = {column["name"]: column for column in content["tableSchema"]["columns"]}
    assert list(columns) == list(rows[0])
    assert columns["attenuation_red"]["schema:unitText"] == "m-1"
    assert columns["datetime"]["datatype"] == "dateTime"
    assert "4.8/c" in columns["black_disc_visibility"]["dc:description"]
    told = {
        value["schema:value"]: value["schema:description"]
        for value in columns["status"]["schema:valueReference"]}
    assert told["not_one_water"] == str(Status.NOT_ONE_WATER)
    assert "the column reason says why" in told[FAILED]
    for name, column in columns.items():
        assert column["dc:title"]
        for value in column.get("schema:valueReference", []):
            assert re.fullmatch(r"\w+", value["schema:value"])
            assert re.fullmatch(column["datatype"]["format"], value["schema:value"])
        if column["datatype"] in ("double", "integer"):
            assert column["schema:unitText"], name


def test_netcdf_is_a_trajectory_with_everything_in_it(
    exported: Path, rows: list[dict[str, str]]
) -> None:
    xarray = pytest.importorskip("xarray")
    content = json.loads((exported / f"frames.csv{SUFFIX}").read_text())
    described = {
        column["name"]: column.get("schema:valueReference")
        for column in content["tableSchema"]["columns"]}
    with xarray.open_dataset(exported / "frames.nc") as data:
        assert data.attrs["Conventions"] == "CF-1.11, ACDD-1.3"
        assert data.attrs["featureType"] == "trajectory"
        assert data.attrs["uw_visibility_version"]
        parameters = json.loads(data.attrs["uw_visibility_parameters"])
        assert parameters["replay.join"] == ["/ctd.temperature=degC", "/c=m-1"]
        assert data[TEMPERATURE].attrs["units"] == "degC"
        assert {"time", "lon", "lat", "sensor_depth"} <= set(data.coords)
        assert data["time"].values[1] == np.datetime64("2023-11-14T22:13:20.5")
        assert float(data["trajectory"].size) == 1
        for name in ("attenuation_green", "depth", "secchi_depth", TEMPERATURE, "nis"):
            expected = [float(row[name] or "nan") for row in rows]
            np.testing.assert_array_equal(data[name].values, expected)
        beam = data["attenuation_green"]
        assert beam.attrs["units"] == "m-1"
        assert beam.attrs["ancillary_variables"].split() == ["attenuation_green_stddev", "status"]
        assert data["visibility_distance"].attrs["ancillary_variables"].split() == [
            "visibility_distance_stddev", "visibility_distance_low", "visibility_distance_high",
            "visibility_status"]
        assert data["right_stamp"].values[1] == np.datetime64("2023-11-14T22:13:20.5")
        for name in ("attenuation_green", "beam_attenuation", "filtered_beam_attenuation_stddev"):
            assert 520.0 < float(data[name].coords["wavelength_green"]) < 540.0
        assert float(data["diffuse_attenuation_490"].coords["wavelength_diffuse"]) == 490.0
        # A transmissometer reads about twice what a camera sees.
        assert not [name for name in data if "beam" in data[name].attrs.get("standard_name", "")]
        meanings = data["status"].attrs["flag_meanings"].split()
        assert len(meanings) == len(data["status"].attrs["flag_values"])
        assert meanings[int(data["status"].values[0])] == "ok"
        for name in ("status", "visibility_status", "filtering", "plausibility"):
            words = data[name].attrs["flag_meanings"].split()
            flags = dict(zip(data[name].attrs["flag_values"], words, strict=True))
            assert [flags.get(k, "") for k in data[name].values] == [r[name] for r in rows], name
            assert words == [value["schema:value"] for value in described[name]]
        types = data["water_type"].attrs["flag_meanings"].split()
        assert [
            types[int(k)] if np.isfinite(k) else "" for k in data["water_type"].values
        ] == [row["water_type"] for row in rows]
        assert np.isfinite(data["lon"].values).sum() == LAST_FIX
        assert data["plausibility_reason"].values[0] == rows[0]["plausibility_reason"]


def test_netcdf_says_what_it_is_when_and_where(
    exported: Path, rows: list[dict[str, str]]
) -> None:
    xarray = pytest.importorskip("xarray")
    with xarray.open_dataset(exported / "frames.nc") as data:
        said = data.attrs
        assert (said["license"], said["institution"]) == ("CC-BY-4.0", "Institute of x=y")
        for name in ("title", "summary", "keywords", "id", "history", "source", "comment"):
            assert said[name]
        assert said["time_coverage_start"] == rows[0]["datetime"]
        assert said["time_coverage_end"] == rows[-1]["datetime"]
        assert said["time_coverage_duration"] == "PT2.500S"
        assert said["time_coverage_resolution"] == "PT0.500S"
        places = [float(row["longitude"]) for row in rows if row["longitude"]]
        assert (said["geospatial_lon_min"], said["geospatial_lon_max"]) == (
            min(places), max(places))
        assert said["geospatial_lat_min"] == said["geospatial_lat_max"] == 59.5
        depths = [float(row["sensor_depth"]) for row in rows if row["sensor_depth"]]
        assert said["geospatial_vertical_max"] == max(depths)
        assert said["geospatial_vertical_positive"] == "down"
        assert f"59.5 {max(places)!r}" in said["geospatial_bounds"]
        kinds = {data[name].attrs["coverage_content_type"] for name in data.data_vars
                 if data[name].attrs.get("coverage_content_type")}
        assert kinds == {"physicalMeasurement", "qualityInformation", "auxiliaryInformation"}


def netcdf_of(
    folder: Path, rows: Iterable[dict[str, str]], columns: Mapping[str, Column] = COLUMNS
) -> Path:
    """Write a table of these rows and make a NetCDF file of it, as a replay does."""
    pytest.importorskip("netCDF4", reason="the extra netcdf is not installed")
    table = TableWriter(folder / "frames.csv", tuple(columns))
    for row in rows:
        table.write(row)
    table.close()
    provenance = {"bag": "dive", "version": "0", "parameters": {}, "input_sha256": "0"}
    write_netcdf(folder / "frames.nc", read_table(folder / "frames.csv", columns), columns,
                 provenance, np.full(3, 500.0))
    return folder / "frames.nc"


@pytest.mark.parametrize("words, told", [
    (["--netcdf", "--attribute", "licence=x"], "--attribute names licence: give one of title, "),
    (["--netcdf", "--attribute", "license"], "--attribute is 'license': give a name and a text"),
    (["--attribute", "license=x"], "--attribute is given without --netcdf"),
    (["--join", "/c="], "--join is '/c=': give a topic"),
])
def test_attributes_and_units_that_cannot_be_used_are_named(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], told: str
) -> None:
    done = run(transect, tmp_path / "out", *words, capsys=capsys)
    assert done.code == 2
    assert told in done.err


@pytest.mark.long
@pytest.mark.node
def test_netcdf_passes_the_checker_of_ioos(exported: Path) -> None:
    checker = shutil.which("compliance-checker", path=Path(sys.executable).parent)
    if checker is None:
        pytest.skip("compliance-checker is not installed")
    done = subprocess.run(
        [checker, "-t", "cf:1.11", "-c", "strict", str(exported / "frames.nc")],
        capture_output=True, text=True, check=False,
    )
    assert done.returncode == 0, done.stdout
    assert "All tests passed!" in done.stdout
    done = subprocess.run(
        [checker, "-t", "acdd:1.3", str(exported / "frames.nc")], capture_output=True, text=True,
        check=False)
    found = re.findall(r"^\* (.+)$", done.stdout, re.MULTILINE)
    # CF has no standard name for some quantities; what else there is only a user knows.
    others = [line for line in found if line != "standard_name"]
    assert len(others) <= 10, others
    assert all(re.match(r"(acknowledg|creator|publisher|project|naming|Attr date)", line)
               for line in others), others


def test_a_long_table_takes_little_memory(exported: Path, tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    row = dict(next(read_rows(exported / "frames.csv")))
    tracemalloc.start()
    file = netcdf_of(tmp_path, (
        {**{c: row[c] for c in COLUMNS}, "frame": str(k), "depth": repr(0.5 * k)}
        for k in range(2000)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # A row as text takes some 15 kB.
    assert peak < 20e6
    with xarray.open_dataset(file) as data:
        np.testing.assert_array_equal(data["frame"].values, np.arange(2000))
        np.testing.assert_array_equal(data["depth"].values, 0.5 * np.arange(2000))
        assert (data["status"].values == 0).all()
        assert (data["time"].values == data["time"].values[0]).all()


def test_a_duration_that_is_joined_is_no_date(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    columns = {**COLUMNS, "joined_age": joined_column("/age", 0, "s")}
    text = columns["joined_age"].text({"scalars": (12.5,)})
    row = {"frame": "0", "datetime": iso_time(0), "stamp": seconds(0), "joined_age": text}
    with xarray.open_dataset(netcdf_of(tmp_path, [row], columns), decode_times=False) as data:
        assert float(data["joined_age"][0]) == 12.5
        assert data["joined_age"].attrs["units"] == "s"
        assert data["stamp"].attrs["units"].startswith("seconds since 1970")


def test_bounds_of_a_track_over_the_date_line_are_around_it(tmp_path: Path) -> None:
    """A pause in the recording is not the time between its frames either."""
    xarray = pytest.importorskip("xarray")
    track = ((0, "179.5"), (1, ""), (2, "-179.75"), (3, "-180.0"), (90_000, "179.25"))
    file = netcdf_of(tmp_path, (
        {"frame": "0", "datetime": iso_time(time * 10**9), "stamp": seconds(time * 10**9),
         "longitude": longitude, "latitude": longitude and "-16.5"}
        for time, longitude in track))
    with xarray.open_dataset(file) as data:
        said = data.attrs
    assert (said["geospatial_lon_min"], said["geospatial_lon_max"]) == (179.25, -179.75)
    assert said["geospatial_bounds"] == (
        "MULTIPOLYGON (((-16.5 179.25, -16.5 180.0, -16.5 180.0, -16.5 179.25, -16.5 179.25)), "
        "((-16.5 -180.0, -16.5 -179.75, -16.5 -179.75, -16.5 -180.0, -16.5 -180.0)))")
    assert said["time_coverage_duration"] == "PT90000.000S"
    assert said["time_coverage_resolution"] == "PT1.000S"


def test_a_recording_without_a_frame_is_told_by_empty_files(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing in it has a partner: tables without rows, and the reason why."""
    xarray = pytest.importorskip("xarray")

    def with_late_right(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in messages:
            if topic == "/right/image_rect":
                message.header.stamp.nanosec += 1_000_000
            yield topic, kind, message, time

    bag = copy_bag(transect, tmp_path / "bag", edit=with_late_right)
    with pytest.raises(SystemExit) as end:
        run(bag, tmp_path / "out", "--netcdf", "--parquet")
    assert end.value.code == 1
    assert f"left image unmatched ({FRAMES})" in capsys.readouterr().out
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "raise synchronization.tolerance" in page
    assert "No frame was compared with it." in page
    with xarray.open_dataset(tmp_path / "out" / "frames.nc") as data:
        assert data.sizes["obs"] == 0
        assert data["reason"].dtype.kind in "OUT"


def test_times_before_1970_are_numbers() -> None:
    for text in ("-5.000000000", "-4.500000000", "-0.000000001", "0.000000000", "1.000000005"):
        assert seconds(round(float(text) * 1e9)) == text


def test_parquet_has_types_and_units(exported: Path, rows: list[dict[str, str]]) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(exported / "frames.parquet")
    assert table.column_names == list(rows[0])
    assert str(table.schema.field("datetime").type) == "timestamp[ns, tz=UTC]"
    assert table.schema.field("secchi_depth").metadata[b"unit"] == b"m"
    assert table["frame"].to_pylist() == list(range(FRAMES))
    assert table["depth"].to_pylist() == [float(row["depth"]) for row in rows]
    assert table["longitude"].null_count == FRAMES - LAST_FIX
    assert table["status"].to_pylist() == ["ok"] * FRAMES
    assert json.loads(table.schema.field("status").metadata[b"values"])["ok"] == "ok"
    assert table.schema.metadata[b"bag"] == b"bag"


def test_geopandas_places_the_frames(exported: Path, rows: list[dict[str, str]]) -> None:
    geopandas = pytest.importorskip("geopandas", reason="geopandas is not installed")
    table = geopandas.read_file(exported / "frames.geojson")
    assert table.crs.to_epsg() == 4326
    placed = rows[:LAST_FIX]
    assert list(table.geometry.x) == [float(row["longitude"]) for row in placed]
    assert list(table.geometry.y) == [float(row["latitude"]) for row in placed]
    assert list(table["attenuation_green"]) == [float(row["attenuation_green"]) for row in placed]
    assert str(table["datetime"].dt.tz) == "UTC"


def test_frames_beyond_the_last_fix_are_told(exported: Path) -> None:
    said = f"2 of {FRAMES} frames have no position: /fix has no fixes around them within 10 s"
    assert said in json.loads((exported / "replay.json").read_text())["damage"]
    assert said in (exported / "report.html").read_text()


def test_messages_open_with_the_library_of_mcap(exported: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    with (exported / "results.mcap").open("rb") as file:
        content = reader.make_reader(file)
        (metadata,) = content.iter_metadata()
        text = metadata.metadata["serialized_metadata"]
        for word in ("uw_visibility.version", "uw_visibility.parameters", "input_sha256"):
            assert word in text
        chunks = content.get_summary().chunk_indexes
        assert {chunk.compression for chunk in chunks} == {"zstd"}
        count = sum(1 for _ in content.iter_messages(topics=["/visibility/attenuation"]))
        assert count == FRAMES


def test_report_shows_derived_quantities_and_joined_topics(exported: Path) -> None:
    text = (exported / "report.html").read_text()
    for word in ("black-disc visibility", "Secchi depth", "/ctd.temperature",
                 "which needs 8 different ones"):
        assert word in text


@pytest.mark.parametrize("join, said", [
    ("/nothing", "there is no topic /nothing in the recording"),
    ("/ctd.", "--join is '/ctd.'"),
    ("/c --join /c", "--join names /c twice"),
    ("/fix", "/fix has 6 numbers: name one of them, /fix.status.status"),
    ("/ctd.salinity", "/ctd has no number salinity"),
])
def test_what_cannot_be_joined_is_one_sentence(
    join: str, said: str, exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done = run(
        exported.with_name("bag"), tmp_path / "out", "--join", *join.split(), capsys=capsys)
    assert done.code == 2
    assert said in done.err
    assert done.err.count("\n") == 1


def test_values_beyond_single_precision_are_told_and_not_joined(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such as the largest double, which some drivers send for want of a value."""
    types = get_typestore(Stores.ROS2_JAZZY).types

    def with_huge(messages: Iterator[Message]) -> Iterator[Message]:
        for number, message in enumerate(messages):
            yield message
            for k in range(2):
                value = (-1.0) ** k * (1.7e308 if number % 3 else 3e38)
                yield "/c", "std_msgs/msg/Float64", types["std_msgs/msg/Float64"](
                    data=value), message[3] + k

    bag = copy_bag(transect, tmp_path / "bag", edit=with_huge)
    done = run(bag, tmp_path / "out", "--join", "/c", capsys=capsys)
    assert done.code == 0
    assert "/c is 1.7e+308: only finite numbers are joined, of up to 3.4e+38" in done.err
    assert all(abs(float(row["joined_c"] or 0)) < 3.1e38 for row in done.rows)


def test_an_odometry_needs_an_origin(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    types = get_typestore(Stores.ROS2_JAZZY).types

    def with_odometry(messages: Iterator[Message]) -> Iterator[Message]:
        for message in messages:
            yield message
            if message[0] == "/depth_sensor":
                yield "/odom", "nav_msgs/msg/Odometry", odometry(types, message[2]), message[3]

    bag = copy_bag(transect, tmp_path / "bag", edit=with_odometry)
    done = run(bag, tmp_path / "out", "--geo", "/odom", capsys=capsys)
    assert done.code == 2
    assert "/odom is an Odometry, in metres" in done.err
    assert "--origin LAT LON" in done.err
    done = run(bag, tmp_path / "out", "--geo", "/odom", "--origin", "59", "10", "--every", "5")
    assert [float(row["longitude"]) for row in done.rows] == [10.0, 10.0]


def odometry(types: Any, pose: Any) -> Any:
    zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    return types["nav_msgs/msg/Odometry"](
        header=pose.header, child_frame_id="base",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose.pose.pose, covariance=np.zeros(36)),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](
            twist=types["geometry_msgs/msg/Twist"](linear=zero, angular=zero),
            covariance=np.zeros(36)),
    )


def test_a_table_of_this_kind_is_plain_csv(exported: Path) -> None:
    with (exported / "frames.csv").open(newline="") as file:
        widths = {len(row) for row in csv.reader(file)}
    assert len(widths) == 1


def test_turbidity_follows_the_fit_to_a_sensor(transect: Path, tmp_path: Path) -> None:
    LineFit("/turbidity.data", "beam_attenuation", 0.5, 8.0, 0.1, 0.4, -0.03, 0.2, 0.9, 0.15, 0.3,
            40).write(tmp_path / "fit.json")
    fit = str(tmp_path / "fit.json")
    done = run(transect, tmp_path / "out", "--every", "5", "--turbidity", fit)
    assert done.code == 0
    for row in done.rows:
        beam = float(row["beam_attenuation"])
        assert float(row["turbidity"]) == pytest.approx(0.5 + 8.0 * beam)
        assert float(row["turbidity_stddev"]) > 8.0 * float(row["beam_attenuation_stddev"])
        assert row["filtered_turbidity"]
    described = json.loads((tmp_path / "out" / f"frames.csv{SUFFIX}").read_text())
    assert "FNU" in json.dumps(described)


@pytest.mark.parametrize("ros1", [False, True])
def test_all_topics_are_those_of_the_foxglove_layout(
    transect: Path, tmp_path: Path, ros1: bool
) -> None:
    bag = copy_bag_ros1(transect, tmp_path / "old.bag") if ros1 else transect
    layout = (Path(__file__).parents[3] / "foxglove" / "uw_visibility.json").read_text()
    wanted = {
        topic.partition(".")[0]
        for topic in re.findall(r'"(?:\w*[tT]opic\w*|value)": "(/[^"]+)"', layout)
    }
    assert {"/left/image_rect", "/diagnostics", "/depth_sensor"} <= wanted
    done = run(bag, tmp_path / "out", "--every", "3", "--duration", "2", "--all-topics")
    assert done.code == 0
    with BagReader(tmp_path / "out" / "results.mcap") as reader:
        found: dict[str, list[Any]] = {}
        for message in reader.messages():
            found.setdefault(message.topic, []).append(reader.deserialize(message))
    assert wanted <= set(found)
    # Recorded inputs are all there, of frames that were left out too.
    assert len(found["/left/image_rect"]) == 4
    assert found["/left/image_rect"][1].header.stamp.nanosec == 500_000_000
    first = found["/diagnostics"][0]
    assert {status.name: status.message for status in first.status} | {
        "uw_visibility: pipeline": "ok", "uw_visibility: water": "ok",
    } == {status.name: status.message for status in first.status}
