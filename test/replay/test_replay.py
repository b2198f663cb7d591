# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The command on a simulated transect: what it writes, and what it depends on."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bag_copies import (
    FRAMES,
    HARD_PARAMETERS,
    WALL,
    Message,
    compressed,
    copy_bag,
    fix,
    messages_of,
    parameter_file,
    run,
)
from rosbags.typesys import Stores, get_typestore
from scenes import processed

from uw_visibility import replay
from uw_visibility.cli import main
from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.messages.estimates import NIS_TOPICS
from uw_visibility.messages.frames import StereoFrame
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.messages.outputs import all_topics
from uw_visibility.messages.processor import FrameProcessor
from uw_visibility.replay.bags.decoder import jazzy_types
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.columns import COLUMNS
from uw_visibility.replay.table import read_rows
from uw_visibility.water.series.tracking import WaterTracker

ALONE = {"tracking.enabled": False, "threads": 1}


def frames_of(bag: Path) -> Iterator[StereoFrame]:
    with BagReader(bag) as reader:
        found: dict[str, list[Any]] = {}
        for m in reader.messages():
            found.setdefault(m.topic, []).append(reader.deserialize(m))
        for messages in zip(*(found[f"/{t}"] for t in (
            "left/image_rect", "right/image_rect", "left/camera_info", "right/camera_info",
        )), strict=True):
            yield StereoFrame(*messages)


def test_every_frame_has_a_row_and_every_topic_its_messages(
    transect: Path, replayed: Path
) -> None:
    assert {p.name for p in replayed.iterdir()} == {
        "results.mcap", "frames.csv", "frames.csv-metadata.json", "timings.csv", "report.html",
        "replay.json",
    }
    rows = list(read_rows(replayed / "frames.csv"))
    assert tuple(rows[0]) == tuple(COLUMNS)
    assert [row["frame"] for row in rows] == [str(k) for k in range(FRAMES)]
    assert {row["status"] for row in rows} == {"ok"}
    with BagReader(replayed / "results.mcap") as reader:
        assert set(reader.topics) == {f"/{t}" for t in all_topics(NodeConfig())} | {
            "/depth_plausibility/nis", "/depth_plausibility/nis_stamped"}
        nis, stamped = [], []
        for m in reader.messages():
            message = reader.deserialize(m)
            if hasattr(message, "header"):
                assert stamp_to_nanoseconds(message.header.stamp) == m.time
            if m.topic == "/depth_plausibility/nis":
                nis.append((m.time, message.data))
            if m.topic == "/depth_plausibility/nis_stamped":
                assert message.header.frame_id == NodeConfig().depth_frame
                stamped.append(message.vector)
    assert [v for _, v in nis] == [float(row["nis"]) for row in rows if row["nis"]]
    assert len(nis) >= FRAMES - 1
    assert [(v.x, f"{v.y:.6g}") for v in stamped] == [
        (float(row["nis"]), f"{float(row['innovation']):.6g}") for row in rows if row["nis"]]
    np.testing.assert_allclose([v.y**2 / v.z for v in stamped], [v.x for v in stamped])
    with BagReader(transect) as reader:
        depths = [
            -reader.deserialize(m).pose.pose.position.z
            for m in reader.messages(["/depth_sensor"])
        ]
    np.testing.assert_allclose([float(row["sensor_depth"]) for row in rows], depths)


def test_messages_and_table_are_those_of_the_common_path(transect: Path, tmp_path: Path) -> None:
    """Without the filter over frames, byte for byte what the node's processor makes."""
    params = parameter_file(tmp_path / "p.yaml", ALONE)
    assert run(transect, tmp_path / "out", "--params-file", params).code == 0
    found = {(t, time): data for t, time, data in messages_of(tmp_path / "out")}
    types = get_typestore(Stores.ROS2_JAZZY)
    processor = FrameProcessor(jazzy_types()[1], False)
    config, topics = PipelineConfig.from_parameters(ALONE), all_topics(NodeConfig())
    rows = read_rows(tmp_path / "out" / "frames.csv")
    for frame, row in zip(frames_of(transect), rows, strict=True):
        result, messages = processed(processor, frame, config, NodeConfig(), topics)
        time = stamp_to_nanoseconds(frame.left.header.stamp)
        for topic, message in messages.items():
            expected = bytes(types.serialize_cdr(message, topics[topic]))
            assert found.pop((f"/{topic}", time)) == expected, topic
        assert float(row["visibility_distance"]) == result.visibility.distance
        assert float(row["attenuation_green"]) == result.water.attenuation[1]
        assert float(row["matched_fraction"]) == result.stereo.matched_fraction
        assert row["filtered_depth"] == ""
    assert {topic for topic, _ in found} == {f"/{topic}" for topic in NIS_TOPICS}


def test_filtered_messages_are_those_of_a_filter_over_all_frames(
    transect: Path, replayed: Path
) -> None:
    processor = FrameProcessor(jazzy_types()[1], False)
    config = PipelineConfig.from_parameters({"threads": 1})
    tracker = WaterTracker(config.tracking)
    with BagReader(replayed / "results.mcap") as reader:
        found = {
            (m.topic, m.time): reader.deserialize(m)
            for m in reader.messages(["/visibility/attenuation"])
        }
    for frame in frames_of(transect):
        result, _ = processed(processor, frame, config, NodeConfig(), [])
        time = stamp_to_nanoseconds(frame.left.header.stamp)
        vector = found["/visibility/attenuation", time].vector
        water = tracker.update(result.water, 1e-9 * time)
        np.testing.assert_array_equal([vector.x, vector.y, vector.z], water.attenuation)


@pytest.mark.node
def test_jobs_change_nothing_and_what_lies_beside_them_is_not_run(
    hard: Path, hard_replayed: Path, hostile_folder: Path, tmp_path: Path
) -> None:
    """Neither the filter's state, nor the learned bias, nor what a restart forgets.

    Processes of Python's own pools import from the current folder first.
    """
    # As the installed command is: its own folder is searched, not the current one.
    command = tmp_path / "command.py"
    command.write_text(
        'from uw_visibility.cli import main\n'
        'if __name__ == "__main__":\n'
        # As `plain_report` does in this process.
        '    from uw_visibility.replay.report import report\n'
        '    report.draw_series = report.draw_tracks = lambda *_: []\n'
        '    main()\n'
    )
    params = parameter_file(tmp_path / "p.yaml", HARD_PARAMETERS)
    done = subprocess.run(
        [sys.executable, str(command), "replay", str(hard), "-o", "out", "--params-file", params,
         "--jobs", "2"], cwd=hostile_folder, capture_output=True, text=True, check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not (hostile_folder / "ran").exists()
    out = hostile_folder / "out"
    assert (out / "frames.csv").read_bytes() == (hard_replayed / "frames.csv").read_bytes()
    assert messages_of(out) == messages_of(hard_replayed)


def test_a_frame_that_is_refused_alone_is_restored_with_the_water_before(
    hard: Path, hard_replayed: Path
) -> None:
    rows = list(read_rows(hard_replayed / "frames.csv"))
    assert rows[WALL]["status"] == "range_spread_too_small"
    assert {rows[WALL - 1]["status"], rows[WALL + 1]["status"]} == {"ok"}
    time = sorted({time for topic, time, _ in messages_of(hard_replayed)})[WALL - 1]
    (told,) = (
        data for topic, at, data in messages_of(hard_replayed)
        if (topic, at) == ("/left/enhanced/image", time))
    with BagReader(hard) as reader:
        (raw,) = (m.data for m in reader.messages(["/left/image_rect"]) if m.time == time)
    assert len(told) == len(raw)
    assert told != raw


def test_the_result_says_where_it_comes_from(transect: Path, replayed: Path) -> None:
    expected = hashlib.sha256((transect / "transect.mcap").read_bytes()).hexdigest()
    state = json.loads((replayed / "replay.json").read_text())
    assert (state["complete"], state["input_sha256"]) == (True, expected)
    assert state["parameters"]["water.veil"] == "free"
    # Where rosbag2 keeps custom data: in the file's metadata, as YAML.
    data = (replayed / "results.mcap").read_bytes()
    for text in ("uw_visibility.version", "uw_visibility.parameters", expected):
        assert text.encode() in data


def test_a_part_is_replayed(transect: Path, replayed: Path, tmp_path: Path) -> None:
    every = run(transect, tmp_path / "every", "--every", "4")
    assert [row["frame"] for row in every.rows] == ["0", "4"]
    part = run(transect, tmp_path / "part", "--start", "1", "--duration", "1")
    whole = list(read_rows(replayed / "frames.csv"))
    assert [row["stamp"] for row in part.rows] == [row["stamp"] for row in whole[2:4]]
    assert part.rows[0]["depth"] == whole[2]["depth"]
    for option, value in (("--every", "0"), ("--start", "-1"), ("--duration", "0"),
                          ("--start", "100")):
        assert run(transect, tmp_path / "none", option, value).code == 2
    for origin in (("95", "0"), ("nan", "0"), ("0", "400")):
        options = ("--geo", "/odom", "--origin", *origin)
        assert run(transect, tmp_path / "none", *options).code == 2
    assert {p.name for p in tmp_path.iterdir()} == {"every", "part"}


def test_a_calibration_sent_once_before_the_start_holds(transect: Path, tmp_path: Path) -> None:
    def latched(messages: Iterator[Message]) -> Iterator[Message]:
        sent = set()
        for message in messages:
            if not message[0].endswith("camera_info") or message[0] not in sent:
                sent.add(message[0])
                yield message

    bag = copy_bag(transect, tmp_path / "bag", edit=latched)
    done = run(bag, tmp_path / "out", "--start", "1.5")
    assert [row["status"] for row in done.rows] == ["ok"] * (FRAMES - 3)


def test_a_calibration_from_a_file_takes_the_place_of_camera_info(
    transect: Path, replayed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def without(messages: Iterator[Message]) -> Iterator[Message]:
        return (m for m in messages if not m[0].endswith("camera_info"))

    bag = copy_bag(transect, tmp_path / "bag", edit=without)
    assert run(bag, tmp_path / "out").code == 2
    assert "give --calibration" in capsys.readouterr().err
    info = next(frames_of(transect)).left_info
    left = info.p.reshape(3, 4)
    right = left.copy()
    right[0, 3] = -150.0 * 0.12
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(
        {"P1": left.tolist(), "P2": right.tolist(), "width": 160, "height": 120}
    ))
    assert main(["replay", str(bag), "--list", "--calibration", str(path)]) == 0
    assert capsys.readouterr().out.count("as --calibration says") == 2
    assert run(bag, tmp_path / "out", "--calibration", str(path)).code == 0
    expected = (replayed / "frames.csv").read_bytes()
    assert (tmp_path / "out" / "frames.csv").read_bytes() == expected
    raw = copy_bag(bag, tmp_path / "raw", edit=lambda messages: (
        (topic.replace("image_rect", "image_raw"), *others) for topic, *others in messages))
    content = json.loads(path.read_text()) | {"D_left": [-0.1, 0, 0, 0]}
    path.write_text(json.dumps(content))
    capsys.readouterr()
    for words, reason in (
        ((), "/left/image_raw is raw by its name, and by its calibration not rectified"),
        (("--rectify",), f"{path} has no K_left, R1, K_right, D_right, R2: add them to rectify"),
    ):
        assert run(raw, tmp_path / "no", "--calibration", str(path), *words).code == 2
        assert reason in capsys.readouterr().err


def test_pictures_video_and_map_on_request(transect: Path, tmp_path: Path) -> None:
    def with_fix(messages: Iterator[Message]) -> Iterator[Message]:
        for message in messages:
            yield message
            if message[0] == "/depth_sensor":
                yield fix(message, 59.5, 10.5)

    bag = copy_bag(transect, tmp_path / "bag", edit=with_fix)
    out = tmp_path / "out"
    done = run(bag, out, "--images", "3", "--video", "--geo", "/fix")
    assert done.code == 0
    assert sorted(p.name for p in (out / "images").iterdir()) == [
        "frame_000000.png", "frame_000003.png"]
    picture = cv2.imread(str(out / "images" / "frame_000003.png"))
    above, below = 16, picture.shape[0] - 136
    assert picture.shape[1] == 480
    # Which frame and how far one sees is a line, what is assumed further ones.
    assert below > 2 * 16
    assert all(picture[:16, x:x + 160].any() for x in (0, 160, 320))
    assert all(picture[136 + y:152 + y, x:].any() for x, y in ((0, 0), (0, 16), (320, 16)))
    raw = list(frames_of(transect))[3].left.data.reshape(120, 160, 3)
    np.testing.assert_array_equal(picture[above:136, :160, ::-1], raw)
    page = (out / "report.html").read_text()
    reported = [
        cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        for data in re.findall(r'alt="Frame 0: [^>]*base64,([^"]*)"', page)
    ]
    np.testing.assert_array_equal(
        cv2.imread(str(out / "images" / "frame_000000.png"))[above:136], np.hstack(reported))
    video = cv2.VideoCapture(str(out / "video.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == FRAMES
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(2.0)
    features = json.loads((out / "frames.geojson").read_text())["features"]
    assert [f["geometry"]["coordinates"] for f in features] == [[10.5, 59.5]] * FRAMES
    assert features[0]["properties"]["visibility_status"] == "ok"
    assert features[0]["properties"]["depth"] == float(done.rows[0]["depth"])


def test_raw_images_are_rectified_or_refused(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = shared_data / "underwater" / "bermuda_raw_bag"
    done = run(bag, tmp_path / "out", capsys=capsys)
    assert done.code == 2
    assert "add --rectify" in done.err
    assert list(tmp_path.iterdir()) == []
    done = run(bag, tmp_path / "out", "--rectify", "--images", "5")
    assert (done.code, len(done.rows)) == (0, 12)
    assert "unusable" not in {row["status"] for row in done.rows}
    # Nothing is restored, as the water is not known; the recorded image is rectified as well.
    assert {row["visibility_status"] for row in done.rows} == {"attenuation_uncertain"}
    picture = cv2.imread(str(tmp_path / "out" / "images" / "frame_000005.png"))
    width = picture.shape[1] // 3
    np.testing.assert_array_equal(picture[20:250, :width], picture[20:250, width:2 * width])


def test_pictures_are_rectified_where_the_right_image_is_later(
    transect: Path, tmp_path: Path
) -> None:
    matrix = np.array([140, 0, 70, 0, 140, 59, 0, 0, 1.0])

    def raw(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in messages:
            if topic.endswith("camera_info"):
                message = replace(message, k=matrix)
            elif topic == "/right/image_rect":
                stamp = message.header.stamp
                later = replace(stamp, nanosec=stamp.nanosec + 1_000_000)
                message = replace(message, header=replace(message.header, stamp=later))
            yield topic.replace("image_rect", "image_raw"), kind, message, time

    bag = copy_bag(transect, tmp_path / "bag", edit=raw)
    params = parameter_file(tmp_path / "p.yaml", {"synchronization.tolerance": 0.01})
    done = run(bag, tmp_path / "out", "--rectify", "--images", "3", "--params-file", params)
    assert (done.code, len(done.rows)) == (0, FRAMES)
    picture = cv2.imread(str(tmp_path / "out" / "images" / "frame_000003.png"))
    shown = picture[16:136, :160, ::-1]
    # The rectified image is moved to the right, and black where the raw one has nothing.
    assert not shown[:, 0].any()
    recorded = list(frames_of(transect))[3].left.data.reshape(120, 160, 3)
    assert np.abs(shown.astype(float) - recorded).mean() > 1.0


@pytest.mark.parametrize("matrix", ["d", "r", "k", ""])
def test_compressed_raw_images_are_refused_as_well(
    matrix: str, transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    turn = cv2.Rodrigues(np.array([0.0, 0.01, 0.0]))[0].ravel()
    other = {"d": np.full(5, 0.1), "r": turn, "k": np.array([140, 0, 79, 0, 140, 59, 0, 0, 1.0])}

    def raw(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in compressed(messages):
            if topic.endswith("camera_info") and matrix:
                message = replace(message, **{matrix: other[matrix]})
            yield topic.replace("image_rect", "image_raw"), kind, message, time

    bag = copy_bag(transect, tmp_path / "bag", edit=raw)
    done = run(bag, tmp_path / "out", "--every", "9", capsys=capsys)
    # Without any of them the images are rectified, whatever their name.
    assert done.code == (2 if matrix else 0)
    assert ("/left/image_raw/compressed is raw by its name" in done.err) is bool(matrix)


def test_the_library_yields_what_the_command_writes(
    transect: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    params = parameter_file(tmp_path / "p.yaml", ALONE)
    rows = run(transect, tmp_path / "out", "--params-file", params).rows
    frames = list(replay.read(transect, ALONE))
    assert [f.number for f in frames] == list(range(FRAMES))
    for frame, row in zip(frames, rows, strict=True):
        assert float(row["depth"]) == frame.result.visibility.depth
        assert frame.result.stereo.confidence is not None
        assert frame.messages["disparity"].header.stamp.sec == frame.stamp // 10**9
    assert len(list(replay.read(transect, ALONE, start=1.0, every=2))) == 2
    first = list(replay.read(transect, ALONE, duration=1.5))
    assert [f.number for f in first] == [
        f.number for f in frames if f.time < frames[0].time + 1_500_000_000]
    assert 0 < len(first) < FRAMES
    swapped = replay.Wanted(left="/right/image_rect", right="/left/image_rect")
    assert list(replay.read(transect, ALONE, topics=swapped)) == []
    assert "are left and right swapped?" in caplog.text
    with pytest.raises(InputError, match=r"water\.bin"):
        next(replay.read(transect, {"water.bin": 3}))


def test_the_pair_as_recorded_is_matched_on_request(
    transect: Path, replayed: Path, tmp_path: Path
) -> None:
    rows = run(transect, tmp_path / "out", "--match-original").rows
    for row, without in zip(rows, read_rows(replayed / "frames.csv"), strict=True):
        assert without["matched_fraction_original"] == ""
        # Water takes contrast, and with it matches.
        assert 0.2 < float(row["matched_fraction_original"]) < float(row["matched_fraction"])
        del row["matched_fraction_original"], without["matched_fraction_original"]
        assert row == without
    assert "without restoration" in (tmp_path / "out" / "report.html").read_text()
    frame = next(replay.read(transect, match_original=True))
    assert frame.result.stereo.matched_fraction_original is not None
