# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Several bags, odd ones, and what is said of them."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from time import sleep

import cv2
import pytest
from bag_copies import FRAMES, Message, copy_bag, run
from rosbags.typesys import Stores, get_typestore

from uw_visibility.cli import main
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.inputs.stream import InputStream, RecordedFrame
from uw_visibility.replay.report.report import write_report


def test_the_list_shows_what_would_be_used(
    transect: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(transect), "--list"]) == 0
    text = capsys.readouterr().out
    assert "ROS 2, 1 file, 2.5 s" in text
    used = text.partition("would be used:")[2]
    assert "/left/image_rect" in used
    assert "/depth_sensor" in used


def test_several_bags_have_a_folder_each(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = copy_bag(transect, tmp_path / "other")
    command = ["replay", str(transect), str(other), "-o", str(tmp_path / "day"), "--jobs", "1"]
    assert main([*command, "--every", "3"]) == 0
    assert {p.name for p in (tmp_path / "day").iterdir() if p.is_dir()} == {"transect", "other"}
    # What the distances are is said, and once is enough.
    assert capsys.readouterr().out.count("Visibility distance is the distance at which") == 1
    assert (tmp_path / "day" / "other" / "report.html").is_file()
    assert main(["replay", str(other), str(other), "-o", str(tmp_path / "twice")]) == 2


def without_pair(messages: Iterator[Message]) -> Iterator[Message]:
    return (m for m in messages if m[0] != "/right/image_rect")


def test_of_several_bags_one_that_cannot_be_used_holds_up_no_other(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    single = copy_bag(transect, tmp_path / "2024.05.01", edit=without_pair)
    other = copy_bag(transect, tmp_path / "2024.05.02", edit=without_pair)
    command = ["replay", str(single), str(other), "-o", str(tmp_path / "day"), "--jobs", "1"]
    # Of none there is a result: bad input.
    assert main(command) == 2
    assert "no pair of images" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main([*command[:3], str(transect), *command[3:], "--every", "3"])
    assert ended.value.code == 1
    printed = capsys.readouterr()
    assert printed.err.count("no pair of images") == 2
    assert re.findall("^uw_visibility: (.*?):", printed.err, re.MULTILINE) == [
        str(single), str(other)]
    assert "transect: Visibility was assessed in both frames, " in printed.out
    assert "2024" not in printed.out
    assert {p.name for p in (tmp_path / "day").iterdir() if p.is_dir()} == {"transect"}


def test_of_several_bags_an_error_inside_costs_one_its_result(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(folder: Path, *arguments: object) -> None:
        if "first" in str(folder):
            raise ZeroDivisionError("a fault of ours")
        write_report(folder, *arguments)

    monkeypatch.setattr("uw_visibility.replay.report.report.write_report", fail)
    first = copy_bag(transect, tmp_path / "first")
    command = ["replay", str(first), str(transect), "-o", str(tmp_path / "day"), "--jobs", "1",
               "--every", "3"]
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert ended.value.code == 1
    printed = capsys.readouterr()
    assert f"{first}: internal error, ZeroDivisionError: a fault of ours (replay it" in printed.err
    assert "transect: Visibility was assessed in both frames, " in printed.out
    page = (tmp_path / "day" / "index.html").read_text(encoding="utf-8")
    assert "first: internal error, ZeroDivisionError" in page
    # By itself it is told as any error inside.
    assert main([*command[:2], "-o", str(tmp_path / "first_alone"), "--jobs", "1"]) == 1


def test_what_is_listed_of_several_bags_does_not_end_at_an_unreadable_one(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    single = copy_bag(transect, tmp_path / "single", edit=without_pair)
    with pytest.raises(SystemExit) as ended:
        main(["replay", str(broken), str(single), str(transect), "--list"])
    assert ended.value.code == 1
    printed = capsys.readouterr()
    assert "cannot read bag" in printed.err
    assert "would be used: nothing, no pair of images" in printed.out
    used, assumed, _ = printed.out.rpartition("would be used:")[2].partition("Camera and light:")
    assert assumed and printed.out.count(assumed) == 1
    lines = {line.split()[-1] for line in used.splitlines() if line}
    assert lines == {"/left/image_rect", "/right/image_rect", "/left/camera_info",
                     "/right/camera_info", "/depth_sensor", "none"}


def test_images_whose_size_changes_within_a_bag(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another resolution is another calibration; images that miss theirs are refused."""
    def smaller(with_info: bool) -> Path:
        def edit(messages: Iterator[Message]) -> Iterator[Message]:
            for topic, kind, message, time in messages:
                if time < 1_700_000_001_500_000_000:
                    pass
                elif kind == "sensor_msgs/msg/Image":
                    pixels = message.data.reshape(message.height, message.width, 3)
                    pixels = cv2.resize(pixels, (120, 90), interpolation=cv2.INTER_AREA)
                    message.height, message.width, message.step = 90, 120, 360
                    message.data = pixels.ravel()
                elif topic.endswith("camera_info") and with_info:
                    message.height, message.width = 90, 120
                    message.k[[0, 2, 4, 5]] *= 0.75
                    message.p[[0, 2, 3, 5, 6]] *= 0.75
                yield topic, kind, message, time

        return copy_bag(transect, tmp_path / f"smaller_{with_info}", edit=edit)

    done = run(smaller(True), tmp_path / "out", "--video", capsys=capsys)
    assert done.code == 0
    assert len(done.rows) == FRAMES
    assert "unusable" not in {row["status"] for row in done.rows}
    assert [row["filtering"] for row in done.rows].count("started") == 2
    with BagReader(tmp_path / "out" / "results.mcap") as reader:
        widths = [reader.deserialize(m).image.width for m in reader.messages(["/disparity"])]
    assert widths == [160] * 3 + [120] * 3
    done = run(smaller(False), tmp_path / "refused", capsys=capsys)
    assert (done.code, [row["status"] for row in done.rows].count("unusable")) == (0, 3)
    reason = done.rows[-1]["reason"]
    assert "120x90" in reason and "160x120" in reason
    assert f"unusable frame: {reason} (3)" in done.out


def test_of_two_pairs_of_cameras_the_choice_is_said(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def twice(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in messages:
            yield topic, kind, message, time
            if topic != "/depth_sensor":
                yield f"/aft{topic}", kind, message, time

    bag = copy_bag(transect, tmp_path / "bag", edit=twice)
    said = "/left/image_rect is used instead of /aft/left/image_rect"
    assert main(["replay", str(bag), "--list"]) == 0
    assert said in capsys.readouterr().out
    done = run(bag, tmp_path / "out", "--every", "3", capsys=capsys)
    assert said in done.out
    assert said in (tmp_path / "out" / "report.html").read_text()
    done = run(bag, tmp_path / "aft", "--every", "3", "--left", "/aft/left/image_rect",
               capsys=capsys)
    assert "rather than" not in done.out
    assert "/aft/right/camera_info" in (tmp_path / "aft" / "report.html").read_text()


@pytest.mark.parametrize("start, duration, frames", [
    (0.0, math.inf, FRAMES), (1.0, math.inf, FRAMES - 2), (1.0, 1.2, 3), (0.0, 1.2, 3),
])
def test_totals_are_those_of_the_part(
    start: float, duration: float, frames: int, transect: Path, tmp_path: Path
) -> None:
    """Where sensors ran long before the cameras did, too."""
    early = 600.0

    def with_early_sensor(messages: Iterator[Message]) -> Iterator[Message]:
        ordered = list(messages)
        topic, kind, message, time = next(m for m in ordered if m[0] == "/depth_sensor")
        yield topic, kind, message, time - round(early * 1e9)
        yield from ordered

    bag = copy_bag(transect, tmp_path / "bag", edit=with_early_sensor)
    shift = early if start or duration < math.inf else 0.0
    options = ReplayOptions(start=start + shift, duration=duration)
    with BagReader(bag) as reader:
        stream = InputStream(reader, options)
        assert stream.expected_frames == frames
        assert sum(isinstance(event, RecordedFrame) for event in stream.events()) == frames


def test_list_names_what_could_be_joined_and_what_has_to_be_rectified(
    transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    types = get_typestore(Stores.ROS2_JAZZY).types

    def edit(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in messages:
            yield topic.replace("image_rect", "image_raw"), kind, message, time
            if topic == "/depth_sensor":
                yield "/c", "std_msgs/msg/Float64", types["std_msgs/msg/Float64"](data=0.5), time
                yield "/ctd", "sensor_msgs/msg/Temperature", types[
                    "sensor_msgs/msg/Temperature"](message.header, 8.0, 0.0), time
                yield "/way", "geometry_msgs/msg/PointStamped", types[
                    "geometry_msgs/msg/PointStamped"](
                        message.header, types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)), time

    bag = copy_bag(transect, tmp_path / "bag", edit=edit)
    assert main(["replay", str(bag), "--list"]) == 0
    listed = capsys.readouterr().out
    assert "/left/image_raw is raw by its name: add --rectify" in listed
    joinable = listed.partition("could be joined with --join:")[2].split("\n")[1:-2]
    assert joinable == ["  /c", "  /ctd", "  /way (.point.x, .point.y, .point.z)"]
    assert "--geo" not in listed


@pytest.mark.parametrize("options, said", [
    (["--nonsense"], "unrecognized arguments: --nonsense"),
    (["--every", "few"], "invalid int value: 'few'"),
    (["--jobs", "-1"], "--jobs is -1: give from 1 to "),
    (["--images", "-1"], "--images is -1: give at least 1"),
    (["--geo", "/gps"], "there is no topic /gps in the recording: --list shows"),
    (["--geo", "/depth_sensor"], "/depth_sensor is a geometry_msgs/msg/PoseWithCovariance"),
    (["--origin", "59", "10"], "--origin is given without --geo"),
    (["--right", "/right/image_rect"], "--right is given without --left: give both"),
    (["--calibration", "none.json"], "none.json"),
    (["--params-file", "none.yaml"], "cannot read parameter file none.yaml"),
])
def test_options_that_cannot_be_used_are_one_sentence(
    options: list[str], said: str, transect: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    done = run(transect, tmp_path / "out", *options, capsys=capsys)
    assert (done.code, done.out) == (2, "")
    (line,) = done.err.splitlines()
    assert said in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.node
def test_an_interruption_at_the_start_of_jobs_is_one_sentence(
    transect: Path, tmp_path: Path
) -> None:
    """Ctrl-C reaches every process of the terminal, those that are still importing too."""
    command = "from uw_visibility.cli import run; run()"
    options = ["replay", str(transect), "-o", str(tmp_path / "out"), "--jobs", "2"]
    process = subprocess.Popen(
        [sys.executable, "-c", command, *options], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    )
    # Those that it starts are importing then.
    started = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while process.poll() is None and not started.read_text().split():
        sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    told = process.communicate(timeout=60)[1]
    if process.returncode == -signal.SIGINT:
        pytest.skip("Python itself was still starting")
    assert process.returncode == 130
    sentences = told.splitlines()
    assert sentences[-1] == "uw_visibility: interrupted"
    # Once there are frames, a second one says how to go on.
    assert len(sentences) == 1 or "--resume continues it" in sentences[0]
    assert len(sentences) <= 2


def test_without_output_nothing_is_replayed(
    transect: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(transect)]) == 2
    assert "-o is missing: name the folder" in capsys.readouterr().err
