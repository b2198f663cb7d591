# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Of several recordings, some lack what is to be joined."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from bag_copies import Message, copy_bag, shortened
from rosbags.typesys import Stores, get_typestore

from uw_visibility.cli import main
from uw_visibility.replay.table import read_rows

JOINED = "joined_ctd_temperature"


@pytest.fixture(scope="module")
def bags(transect: Path, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Two recordings: a sensor and a depth under other names than usual in the second alone."""
    types = get_typestore(Stores.ROS2_JAZZY).types

    def with_sensors(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in messages:
            yield topic, kind, message, time
            if topic == "/depth_sensor":
                yield "/z", kind, message, time
                yield "/ctd", "sensor_msgs/msg/Temperature", types[
                    "sensor_msgs/msg/Temperature"](message.header, 8.0, 0.0), time

    folder = tmp_path_factory.mktemp("lacks")
    return [str(copy_bag(transect, folder / "without")),
            str(copy_bag(transect, folder / "with", edit=with_sensors))]


def test_a_recording_without_a_joined_topic_has_its_result_and_says_so(
    bags: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "day"
    command = ["replay", *bags, "-o", str(out), "--jobs", "1", "--every", "3",
               "--join", "/ctd.temperature", "--depth", "/z"]
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert ended.value.code == 1
    sentences = [
        f"{name} is not joined: there is no topic {topic} in the recording"
        for name, topic in (("/ctd.temperature", "/ctd"), ("/z", "/z"))]
    printed = capsys.readouterr()
    assert [line for line in printed.err.splitlines() if "joined" in line] == [
        f"uw_visibility: {bags[0]}: {sentence}" for sentence in sentences]
    assert "without: Visibility was assessed in both frames, " in printed.out

    rows = list(read_rows(out / "frames.csv"))
    told = {name: [(row[JOINED], bool(row["sensor_depth"])) for row in rows
                   if row["transect"] == name] for name in ("without", "with")}
    # Another depth sensor than the one asked for does not take its place.
    assert told == {"without": [("", False)] * 2, "with": [("8.0", True)] * 2}
    for page, times in (("index.html", 1), ("without/report.html", 1), ("with/report.html", 0)):
        text = re.sub(r"\s+", " ", (out / page).read_text(encoding="utf-8"))
        assert [text.count(sentence) for sentence in sentences] == [times, times], page
    assert json.loads((out / "without" / "replay.json").read_text())["lacks"] == sentences
    transects = json.loads((out / "transects.json").read_text())["transects"]
    assert {each["transect"]: each["lacks"] for each in transects} == {
        "without": sentences, "with": []}

    # What is complete already is told the same way.
    with pytest.raises(SystemExit) as ended:
        main([*command, "--resume"])
    assert ended.value.code == 1
    assert sentences[0] in capsys.readouterr().err


def test_what_is_damaged_is_not_told_as_what_was_requested(
    bags: list[str], tmp_path: Path
) -> None:
    cut = tmp_path / "cut"
    shutil.copytree(bags[0], cut)
    shortened(next(cut.glob("*.mcap")), 0.9)
    out = tmp_path / "day"
    with pytest.raises(SystemExit):
        main(["replay", bags[1], str(cut), "-o", str(out), "--jobs", "1", "--every", "3",
              "--join", "/ctd.temperature"])
    text = re.sub(r"\s+", " ", (out / "cut" / "report.html").read_text(encoding="utf-8"))
    assert ("Some of what was requested is missing. Parts of the recording could not be used:"
            in text)


@pytest.mark.parametrize("options, said", [
    (["--join", "/ctb.temperature"], "no recording has /ctb.temperature: there is no topic /ctb"),
    (["--join", "/ctd.temprature"], "no recording has /ctd.temprature: /ctd has no number"),
    (["--join", "/ctd.temperature", "--geo", "/fix"], "no recording has /fix: there is no topic"),
    (["--geo", "/ctd"], "no recording has /ctd: /ctd is a sensor_msgs/msg/Temperature: give"),
])
def test_what_no_recording_has_is_refused_before_the_work(
    options: list[str], said: str, bags: list[str], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "day"
    assert main(["replay", *bags, "-o", str(out), "--jobs", "1", *options]) == 2
    printed = capsys.readouterr().err
    assert said in printed
    assert not list(out.iterdir())


def test_the_list_names_what_a_recording_lacks(
    bags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", *bags, "--list", "--join", "/ctd.temperature"]) == 0
    without, _, listed = capsys.readouterr().out.partition(f"{bags[1]}: ROS 2")
    assert "there is no topic /ctd in the recording" in without.partition("would be used:")[2]
    assert "there is no topic" not in listed
