# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A camera's white and the water's type, found from a bag with a depth sensor."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_copies import DARK, DIVE_FRAMES, Edit, Message, copy_bag, run, shortened

from uw_visibility.cli import main
from uw_visibility.config.parameters import read_yaml
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.optics.spectra import load_response
from uw_visibility.replay.work import Recording, RecordingProcessor
from uw_visibility.water.daylight.one_light import NOTHING_EXPECTED
from uw_visibility.water.meaning.depth import diffuse_attenuation

RESPONSE = load_response("nikon_d5100")
WHITE = np.array([1.0, 0.7, 0.6])


def seen(water_type: str) -> Edit:
    """Let a camera with a white of its own see the dive from under another water.

    One frame is black, and the sensor ends before the last one.
    """
    surplus = diffuse_attenuation(water_type, RESPONSE) - diffuse_attenuation("clear", RESPONSE)

    def edit(messages: Iterator[Message]) -> Iterator[Message]:
        ordered = list(messages)
        depths = {
            time: -message.pose.pose.position.z
            for topic, _, message, time in ordered if topic == "/depth_sensor"
        }
        for topic, kind, message, time in ordered:
            if kind == "sensor_msgs/msg/Image":
                gain = WHITE * np.exp(-surplus * depths[time])
                pixels = message.data.reshape(-1, 3) * (0.95 * gain / gain.max())
                message.data = np.ravel(pixels.round().astype(np.uint8))
                if time == sorted(depths)[DARK]:
                    message.data = np.zeros_like(message.data)
            if topic != "/depth_sensor" or time < max(depths):
                yield topic, kind, message, time

    return edit


def depth_error(rows: list[dict[str, str]], deviations: float = np.inf) -> float:
    """Root mean square; frames count up to so many (robust) deviations."""
    errors = np.array([
        abs(float(r["depth"]) - float(r["sensor_depth"]))
        for r in rows if r["depth"] and r["sensor_depth"]
    ])
    return float(np.sqrt(np.mean(
        np.minimum(errors, deviations * 1.4826 * np.median(errors)) ** 2)))


# Of a dozen small frames, a type cannot be told from its neighbour.
@pytest.mark.parametrize("water_type, alike", [("clear", {"clear", "IB"}), ("3C", {"1C", "3C"})])
def test_white_and_water_are_found_and_make_the_depth_right(
    water_type: str, alike: set[str], dive: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str]
) -> None:
    bag = copy_bag(dive, tmp_path / "bag", edit=seen(water_type))
    given, found = tmp_path / "given.yaml", tmp_path / "found.yaml"
    given.write_text(
        "/**: {ros__parameters: {water: {daylight_tolerance: 0.2}, plausibility.max_gate: 4.0}}")
    command = ["calibrate", str(bag), "--jobs", "1", "--params-file", str(given)]
    assert main([*command, "--transfer", "linear", "-o", str(found)]) == 0
    printed = capsys.readouterr().out
    assert f"{DIVE_FRAMES - 2} of {DIVE_FRAMES} frames have an estimate and a depth" in printed
    assert "±" in printed
    config = PipelineConfig.from_yaml(found)
    assert config.assessment.water_type in alike
    np.testing.assert_allclose(config.camera.white_reference, WHITE / WHITE[1], rtol=0.12)
    # What was given before is there as well, so that the file takes the other one's place.
    values = read_yaml(found)
    assert (values["water.daylight_tolerance"], values["plausibility.max_gate"]) == (0.2, 4.0)
    assert values["camera.transfer"] == "linear"
    before = depth_error(run(bag, tmp_path / "before", "--params-file", str(given)).rows)
    after = depth_error(run(bag, tmp_path / "after", "--params-file", str(found)).rows)
    assert after < 0.6 < 2.0 < before
    told = re.search(r"rms: ([\d.]+) m before, ([\d.]+) m with", printed)
    # What is told is of estimates that expect nothing of the light's colour, and robust.
    for path in (given, found):
        path.write_text(yaml.safe_dump({"/**": {"ros__parameters": {
            **read_yaml(path), "water.daylight_tolerance": NOTHING_EXPECTED}}}))
    expected = [
        depth_error(run(bag, tmp_path / path.stem, "--params-file", str(path)).rows, 3.0)
        for path in (given, found)]
    # The white changes the restored pair, and so a few matches: of ten frames one, told to
    # 1.9 m, differs by 0.3 m.
    assert (np.abs(np.array(told.groups(), float) - expected) < (0.03, 0.05)).all()


def test_without_output_the_file_is_printed_and_nothing_else(
    dive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    make, used = Recording.of, []
    monkeypatch.setattr(
        Recording, "of", lambda *given: used.append(made := make(*given)) or made
    )
    path = tmp_path / "piped.yaml"
    # Nothing is taken from what is to be found, however wrong it is and however trusted.
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": {
        "camera.white_reference": [1.0, 0.5, 1.5], "water.daylight_tolerance": 0.01,
        "camera.transfer": "srgb"}}}))
    bag = shutil.copytree(dive, tmp_path / "bag")
    shortened(bag / "dive.mcap", 0.97)
    command = ["calibrate", str(bag), "--jobs", "1", "--params-file", str(path)]
    assert main([*command, "--transfer", "linear"]) == 0
    assert [r.pipeline.water.daylight_tolerance for r in used] == [NOTHING_EXPECTED]
    printed = capsys.readouterr()
    path.write_text(printed.out)
    values = read_yaml(path)
    assert set(values) == {
        "camera.white_reference", "assessment.water_type", "water.daylight_tolerance",
        "camera.transfer"}
    assert values["camera.transfer"] == "linear"
    assert printed.err.count(f"--transfer linear is used, not the srgb of {path}") == 1
    np.testing.assert_allclose(values["camera.white_reference"], 1.0, rtol=0.12)
    assert "water type" in printed.err
    assert "warning: " in printed.err and "damaged" in printed.err


def refusal(bag: Path, capsys: pytest.CaptureFixture[str], *options: str) -> str:
    assert main(["calibrate", str(bag), "--jobs", "1", *options]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return lines[0]


def test_what_cannot_tell_white_and_water_apart_is_refused(
    dive: Path, transect: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def level(messages: Iterator[Message]) -> Iterator[Message]:
        for topic, kind, message, time in messages:
            if topic == "/depth_sensor":
                message.pose.pose.position.z *= 0.2
            yield topic, kind, message, time

    flat = copy_bag(dive, tmp_path / "flat", edit=level)
    with monkeypatch.context() as patched:
        # Told by the sensor alone, before an hour of frames.
        patched.setattr(RecordingProcessor, "answer", None)
        assert re.search(r"the depths differ by 0\.[789]\d m only", refusal(flat, capsys))
    assert "6 of 6 frames" in refusal(transect, capsys)
    blind = copy_bag(
        transect, tmp_path / "blind", edit=lambda m: (x for x in m if x[0] != "/depth_sensor")
    )
    assert "has no depth sensor: name its topic with --depth-sensor" in refusal(blind, capsys)
    found = tmp_path / "found.yaml"
    found.write_text("mine")
    assert "exists already" in refusal(transect, capsys, "-o", str(found))
    assert found.read_text() == "mine"
