# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A day of several recordings is one thing: page, table, NetCDF, Parquet and GeoJSON over all."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from bag_copies import Message, copy_bag, fix
from frame_records import frame_estimate, frame_record, write_table
from made_once import leave_out_figures

from uw_visibility.cli import main
from uw_visibility.plausibility.comparison import Verdict
from uw_visibility.replay.columns import COLUMNS, TRANSECT
from uw_visibility.replay.day import DAY_MARK, _depth, write_index
from uw_visibility.replay.records import JoinedFrame
from uw_visibility.replay.results.summary import Summary
from uw_visibility.replay.table import SUFFIX, read_rows, read_table
from uw_visibility_lab.simulation.bag import START, write_transect
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.transect import Transect

HOUR = 3600
LEGS = {"leg 1": (0.1, 2 * HOUR, 2), "leg 2": (0.3, 0, 3), "murky": (2.5, 4 * HOUR, 2)}
"""Attenuation, start after the usual one, and frames; the second is the first by time."""


@pytest.fixture(scope="module", autouse=True)
def plain_report() -> Iterator[None]:
    """Leave the figures of single reports out; the page over all has its own."""
    with pytest.MonkeyPatch.context() as patch:
        leave_out_figures(patch, "report.report")
        yield


def moving_east(messages: Iterator[Message], latitude: float) -> Iterator[Message]:
    """Add a fix to each frame, from 10.5 degrees east on."""
    longitude = 10.5
    for message in messages:
        yield message
        if message[0] == "/left/image_rect":
            yield fix(message, latitude, longitude)
            longitude += 1e-6


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bags")
    for name, (attenuation, later, frames) in LEGS.items():
        plain = folder / "without position" / name
        plain.parent.mkdir(exist_ok=True)
        write_transect(
            plain, Transect(
                frames=frames, attenuation=(attenuation, attenuation),
                camera=StereoCamera(160, 120, 150.0, 0.12)),
            start=START + later * 10**9)
        copy_bag(plain, folder / name, edit=partial(moving_east, latitude=60.0 + later * 1e-7))
    broken = folder / "broken.mcap"
    broken.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    return [folder / "leg 1", broken, folder / "murky", folder / "leg 2"]


@pytest.fixture(scope="module")
def command(bags: list[Path], tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    out = tmp_path_factory.mktemp("days") / "day"
    return ["replay", *map(str, bags), "-o", str(out), "--jobs", "1", "--geo", "/fix",
            "--netcdf", "--parquet"]


@pytest.fixture(scope="module")
def day(command: list[str]) -> Path:
    for library in ("xarray", "netCDF4", "pyarrow"):
        pytest.importorskip(library)
    # One of the recordings cannot be read, and one shows nothing.
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert ended.value.code == 1
    return Path(command[command.index("-o") + 1])


def test_the_index_has_a_row_for_each_recording_by_time(day: Path) -> None:
    text = (day / "index.html").read_text(encoding="utf-8")
    assert re.findall(r'<th scope="row"><a href="([^"]*)">([^<]*)</a>', text) == [
        ("leg%202/report.html", "leg 2"), ("leg%201/report.html", "leg 1"),
        ("murky/report.html", "murky")]
    rows = re.findall(r"<tr>(<th scope=\"row\">.*?)</tr>", text, re.DOTALL)
    told = [" ".join(re.sub(r"<[^>]*>", " ", row).split()) for row in rows]
    assert re.search(
        r"black-disc visibility [\d.]+\sm \([\d.]+ to [\d.]+\); visibility distance [\d.]+\sm "
        r"\([\d.]+ to [\d.]+\)", told[0]), told[0]
    for part in ("2023-11-14 22:13:20 to 22:13:21 UTC", "60.00000° N, 10.50000° E",
                 "2.0 to 6.0 m (sensor)", "all 3 frames, ± "):
        assert part in told[0], told[0]
    assert "2023-11-15 00:13:20" in told[1] and "60.00072° N" in told[1]
    assert "not assessed none of 2 frames Reasons why visibility" in told[2]
    assert "with numbers of frames: too few" in told[2]
    assert re.search(r"Recordings without a result:.*broken: cannot read bag", text, re.DOTALL)


def test_the_verdict_over_all_links_to_the_worst_and_the_best_frame(day: Path) -> None:
    text = (day / "index.html").read_text(encoding="utf-8")
    opening = text[text.index('class="verdict"'):text.index('id="definition"')]
    plain = " ".join(re.sub(r"<[^>]*>", "", opening).split())
    assert "3 of 4 recordings" in text
    assert "Visibility was assessed in 5 of 7 frames (71 %), from" in plain
    assert "transfer linear (assumed; --transfer srgb for video)" in plain
    assert "baseline 0.12 m." in plain
    # Each recording's water is its own.
    assert not re.search("rises|falls|jump", plain)
    worst, best = re.findall(r'<a href="([^"]*)">', opening)[:2]
    assert worst.startswith("leg%202/report.html#frame-")
    assert best.startswith("leg%201/report.html#frame-")
    for name, address in (("leg 2", worst), ("leg 1", best)):
        report = (day / name / "report.html").read_text(encoding="utf-8")
        assert f'id="{address.partition("#")[2]}"' in report
    assert all(
        (day / name.replace("%20", " ")).is_file()
        for name in re.findall(r'href="([^"#]*report.html)', text))


def test_one_table_has_all_frames(day: Path) -> None:
    rows = list(read_rows(day / "frames.csv"))
    assert list(rows[0]) == ["transect", *COLUMNS]
    assert [row["transect"] for row in rows] == ["leg 2"] * 3 + ["leg 1"] * 2 + ["murky"] * 2
    own = [
        {"transect": name, **row} for name in ("leg 2", "leg 1", "murky")
        for row in read_rows(day / name / "frames.csv")]
    assert rows == own
    described = json.loads((day / f"frames.csv{SUFFIX}").read_text(encoding="utf-8"))
    assert described["tableSchema"]["primaryKey"] == ["transect", "frame"]
    assert described["tableSchema"]["columns"][0]["name"] == "transect"


def test_other_readers_find_the_recordings_apart(day: Path) -> None:
    xarray, parquet = pytest.importorskip("xarray"), pytest.importorskip("pyarrow.parquet")
    with xarray.open_dataset(day / "frames.nc") as data:
        assert data.attrs["featureType"] == "trajectory"
        assert data["trajectory"].attrs["cf_role"] == "trajectory_id"
        assert data["transect"].attrs["instance_dimension"] == data["trajectory"].dims[0]
        names = data["trajectory"].values[data["transect"].values]
        assert list(names) == [row["transect"] for row in read_rows(day / "frames.csv")]
        own = xarray.open_dataset(day / "leg 1" / "frames.nc")
        np.testing.assert_array_equal(
            data["visibility_distance"].values[names == "leg 1"],
            own["visibility_distance"].values)
    table = parquet.read_table(day / "frames.parquet").to_pydict()
    assert table["transect"] == list(names)
    points = json.loads((day / "frames.geojson").read_text(encoding="utf-8"))["features"]
    assert [point["properties"]["transect"] for point in points] == list(names)


@pytest.mark.long
@pytest.mark.node
def test_the_netcdf_of_all_passes_the_checker_of_ioos(day: Path) -> None:
    checker = shutil.which("compliance-checker", path=Path(sys.executable).parent)
    if checker is None:
        pytest.skip("compliance-checker is not installed")
    done = subprocess.run(
        # That check fails in the checker itself (6.1.0) for every ragged array.
        [checker, "-t", "cf:1.11", "-c", "strict", "-s", "check_domain_variables",
         str(day / "frames.nc")], capture_output=True, text=True, check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "All tests passed!" in done.stdout


def test_one_map_and_one_course_of_time_are_of_all(day: Path) -> None:
    text = (day / "index.html").read_text(encoding="utf-8")
    names = re.findall(r'<svg class="plot wide"[^>]*><title[^>]*>([^<]*)', text)
    assert names[:3] == [
        "Map of visibility distance", "Map of mean attenuation α",
        "Visibility distance over time"]
    for name in LEGS:
        assert f">{name} start</text>" in text
        # In the figures of visibility, attenuation and depth, wide and narrow.
        assert text.count(f">{name}</text>") == 2 * 3
        assert re.search(rf"<title>{name}, frame 0, \d\d:13:20 UTC; ", text)


def test_going_on_makes_the_same_again(day: Path, command: list[str]) -> None:
    before = {path.name: path.read_bytes() for path in day.glob("frames.*")}
    page = (day / "index.html").read_text(encoding="utf-8")
    with pytest.raises(SystemExit):
        main([*command, "--resume"])
    assert {path.name: path.read_bytes() for path in day.glob("frames.[!n]*")} == {
        name: content for name, content in before.items() if name != "frames.nc"}
    assert (day / "index.html").read_text(encoding="utf-8") == page
    assert not list(day.glob(".writing*"))


def test_nothing_that_is_of_no_day_is_replaced(
    bags: list[Path], day: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "index.html").write_text("mine")
    several = ["replay", str(bags[0]), str(bags[3]), "-o"]
    assert main([*several, str(tmp_path)]) == 2
    assert f"{tmp_path / 'index.html'} exists already" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]
    assert main([*several, str(day / "leg 1")]) == 2
    assert "is the result of one recording" in capsys.readouterr().err
    assert not (day / "leg 1" / DAY_MARK).exists()


def test_the_index_names_the_recording_whose_sensor_disagrees_and_whose_clock_was_set(
    tmp_path: Path
) -> None:
    found = {}
    for name, verdict, jump in (("good", Verdict.OK, 0), ("bad", Verdict.ERROR, 86400)):
        (tmp_path / name).mkdir()
        frames = [
            JoinedFrame(
                frame_record(1.7e9 + k + jump * (k > 3), k, estimate=frame_estimate()), None,
                verdict=verdict)
            for k in range(8)]
        columns = read_table(write_table(tmp_path / name, frames), COLUMNS)
        found[name] = Summary("bag", str(tmp_path / name)), columns
        found[name][0].read(columns, 0.05, {0.1})
    together = {
        column: np.concatenate([columns[column] for _, columns in found.values()])
        for column in COLUMNS} | {TRANSECT: np.repeat(list(found), 8)}
    write_index(tmp_path, "day", together, [summary for summary, _ in found.values()], [])
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    good, bad = (
        " ".join(re.sub("<[^>]*>", " ", row).split())
        for row in re.findall(r"<tr>(<th scope=\"row\">.*?)</tr>", text, re.DOTALL))
    assert "the sensor disagrees with the colour: error in 8 frames" in bad
    assert "2023-11-15 22:13:27 UTC, most of it without frames" in bad
    assert "disagrees" not in good and "without frames" not in good


def test_one_depth_is_one_number() -> None:
    assert _depth({"sensor_depth": np.array([2.01, np.nan, 1.98])}) == "2.0 m (sensor)"
    assert _depth({"sensor_depth": np.array([2.0, 4.9])}) == "2.0 to 4.9 m (sensor)"
