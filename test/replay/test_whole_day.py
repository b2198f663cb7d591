# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A day: five simulated transects, one of them damaged too, and real pairs; by others' readers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bag_copies import copy_bag, leave_out_figures, shortened
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from uw_visibility.cli import main
from uw_visibility_lab.simulation import bag as simulation
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.frame import Effects
from uw_visibility_lab.simulation.transect import Transect

CAMERA = StereoCamera(200, 150, 190.0, 0.12)
LEGS: dict[str, dict[str, Any]] = {
    "turbidity": {"attenuation": (0.05, 0.4)}, "depth": {"depth": (2.0, 10.0)},
    "snow": {"effects": Effects(marine_snow=0.02)}, "turbid": {"attenuation": (0.6, 0.7)},
    "clear": {"attenuation": (0.03, 0.03)},
}
FRAMES = 3
SENSOR = "joined_transmissometer"


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("legs")
    with pytest.MonkeyPatch.context() as patch:
        for number, (name, what) in enumerate(LEGS.items()):
            patch.setattr(simulation, "START", 1_700_000_000 + 3600 * number)
            plan = {"attenuation": (0.1, 0.1), "frames": FRAMES, "seed": number, **what}
            simulation.write_transect(
                folder / name, Transect(camera=CAMERA, **plan), position=(60.0, 10.5 + number))
    damaged = copy_bag(folder / "depth", folder / "damaged")
    shortened(next(damaged.glob("*.mcap")), 0.6)
    return [*(folder / name for name in LEGS), damaged]


def replayed_day(bags: list[Path], out: Path, *options: str) -> Path:
    """Replay all with all products; one has neither the transmissometer nor a position."""
    for library in ("pandas", "xarray", "netCDF4", "pyarrow", "geopandas", "mcap"):
        pytest.importorskip(library)
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
        leave_out_figures(patch, "report.report", "day")
        patch.setattr("uw_visibility.replay.report.report.draw", lambda *_: [])
        main(["replay", *map(str, bags), "-o", str(out), "--jobs", "1", "--join",
              "/transmissometer", "--geo", "/gps/fix", "--netcdf", "--parquet", *options])
    assert ended.value.code == 1
    return out


@pytest.fixture(scope="module")
def day(bags: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return replayed_day(bags, tmp_path_factory.mktemp("whole") / "day")


def check_products(day: Path, names: set[str]) -> Any:
    """Open every product of a day, and of each recording, by a third party's reader.

    Returns the table, by pandas.
    """
    geopandas, pandas = pytest.importorskip("geopandas"), pytest.importorskip("pandas")
    xarray, mcap = pytest.importorskip("xarray"), pytest.importorskip("mcap.reader")
    # Python's own reading of numbers gives back what was written.
    table = pandas.read_csv(day / "frames.csv", parse_dates=["datetime"], converters=dict.fromkeys(
        ("visibility_distance", "longitude"), lambda text: float(text or "nan")))
    assert set(table["transect"]) == names
    described = json.loads((day / "frames.csv-metadata.json").read_text(encoding="utf-8"))
    assert [c["name"] for c in described["tableSchema"]["columns"]] == list(table.columns)

    seen = table["visibility_distance"].to_numpy()
    with xarray.open_dataset(day / "frames.nc") as data:
        np.testing.assert_array_equal(data["visibility_distance"].values, seen)
        whose = data["trajectory"].values[data["transect"].values]
        assert list(whose) == list(table["transect"])
        words = data["status"].attrs["flag_meanings"].split()
        assert [words[int(k)] for k in data["status"].values] == list(table["status"])
    parquet = pandas.read_parquet(day / "frames.parquet")
    np.testing.assert_array_equal(parquet["visibility_distance"].to_numpy(), seen)
    assert (parquet["datetime"] == table["datetime"]).all()

    placed = table[table["longitude"].notna()]
    points = geopandas.read_file(day / "frames.geojson")
    assert list(points.geometry.x) == list(placed["longitude"])
    assert list(points["transect"]) == list(placed["transect"])

    page = (day / "index.html").read_text(encoding="utf-8")
    for name in names:
        assert f'href="{name}/report.html"' in page
        with (day / name / "results.mcap").open("rb") as file:
            found = [channel.topic for _, channel, _ in mcap.make_reader(file).iter_messages()]
        assert found.count("/disparity") == (table["transect"] == name).sum()
    return table


def test_each_product_of_a_day_opens_in_a_third_partys_reader(day: Path) -> None:
    table = check_products(day, {*LEGS, "damaged"})
    assert table.groupby("transect").size().to_dict() == {
        **dict.fromkeys(LEGS, FRAMES), "damaged": (table["transect"] == "damaged").sum()}
    assert 0 < (table["transect"] == "damaged").sum() < FRAMES
    # The transmissometer is at 2 % of the truth.
    known = table.dropna(subset=["beam_attenuation", SENSOR])
    assert len(known) >= 0.8 * FRAMES * len(LEGS)
    score = (known["beam_attenuation"] - known[SENSOR]) / known["beam_attenuation_stddev"]
    assert abs(score).max() < 3.0
    # Where there was no transmissometer, nothing stands.
    assert table.loc[table["transect"] == "damaged", SENSOR].isna().all()
    assert table.loc[table["transect"] != "damaged", "longitude"].notna().all()


def tank_bag(folder: Path, target: Path) -> Path:
    """Record the real pairs of a tank, which are rectified."""
    types = get_typestore(Stores.ROS2_JAZZY)
    message = types.types
    numbers = json.loads((folder / "calibration.json").read_text(encoding="utf-8"))
    with Writer2(target, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topics = {
            (side, kind): writer.add_connection(
                f"/tank/{side}/{name}", f"sensor_msgs/msg/{kind}", typestore=types)
            for side in ("left", "right")
            for kind, name in (("Image", "image_rect"), ("CameraInfo", "camera_info"))}
        for second, left in enumerate(sorted(folder.glob("left_*.png"))):
            header = message["std_msgs/msg/Header"](
                message["builtin_interfaces/msg/Time"](1_700_050_000 + second, 0), "left")
            for side, projection in (("left", "P1"), ("right", "P2")):
                pixels = cv2.imread(str(left.with_name(left.name.replace("left", side))))
                height, width = pixels.shape[:2]
                p = np.array(numbers[projection], np.float64)
                written = {
                    "Image": message["sensor_msgs/msg/Image"](
                        header, height, width, "bgr8", 0, 3 * width, pixels.ravel()),
                    "CameraInfo": message["sensor_msgs/msg/CameraInfo"](
                        header, height, width, "plumb_bob", np.zeros(5), p[:, :3].ravel(),
                        np.eye(3).ravel(), p.ravel(), 0, 0,
                        message["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)),
                }
                for kind, content in written.items():
                    writer.write(
                        topics[side, kind], (1_700_050_000 + second) * 10**9,
                        types.serialize_cdr(content, f"sensor_msgs/msg/{kind}"))
    return target


def test_real_recordings_are_part_of_a_day(
    bags: list[Path], shared_data: Path, tmp_path: Path
) -> None:
    underwater = shared_data / "underwater"
    tank = tank_bag(underwater / "tank", tmp_path / "tank")
    chosen = [bags[0], underwater / "bermuda_raw_bag", bags[-1], tank]
    out = replayed_day(chosen, tmp_path / "day", "--rectify", "--every", "3")
    table = check_products(out, {"turbidity", "bermuda_raw_bag", "damaged", "tank"})
    counts = table.groupby("transect").size()
    assert (counts["bermuda_raw_bag"], counts["tank"]) == (4, 2)
    assert "unusable" not in set(table["status"])
    real = table["transect"].isin(["bermuda_raw_bag", "tank"])
    assert table.loc[real, [SENSOR, "longitude"]].isna().all(axis=None)
    page = (out / "index.html").read_text(encoding="utf-8")
    for name in ("bermuda_raw_bag", "tank"):
        assert f"{name}: /transmissometer is not joined: there is no topic" in page
