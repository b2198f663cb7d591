# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""No command removes what it did not write: inputs, others' files, folders under its names."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from made_once import leave_out_figures

from uw_visibility.cli import main
from uw_visibility.replay.results.recorder import FrameRecorder
from uw_visibility.replay.table import read_rows

pytestmark = pytest.mark.usefixtures("plain_report")

HIDDEN = ".{}.0123456789ab.partial"


def files(folder: Path) -> dict[Path, bytes | None]:
    """Return all that is in a folder, with what files hold."""
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.fixture
def said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run a command that must refuse, and check that everything is as it was."""
    def run(*words: Any) -> str:
        before = files(tmp_path)
        capsys.readouterr()
        single = ["--jobs", "1"] if words[0] == "replay" else []
        assert main([*map(str, words), *single]) == 2
        assert files(tmp_path) == before
        told = capsys.readouterr().err
        assert told.count("\n") == 1, told
        return told

    return run


@pytest.fixture(scope="session")
def made(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result, and a day of two."""
    folder = tmp_path_factory.mktemp("made")
    bags = [str(shutil.copytree(recording, folder / name)) for name in ("one", "two")]
    with pytest.MonkeyPatch.context() as patch:
        leave_out_figures(patch, "report.report", "day")
        assert main(["replay", str(recording), "-o", str(folder / "res"), "--jobs", "1"]) == 0
        assert main(["replay", *bags, "-o", str(folder / "day"), "--jobs", "1"]) == 0
    return folder


@pytest.fixture
def res(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made / "res", tmp_path / "res"))


@pytest.fixture
def day(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made / "day", tmp_path / "day"))


@pytest.mark.parametrize("name", ["in.mcap", "results.mcap", "images/in.mcap"])
def test_a_recording_in_a_result_is_kept(
    name: str, res: Path, recording: Path, said: Callable[..., str]
) -> None:
    (res / name).parent.mkdir(exist_ok=True)
    shutil.copy(next(recording.glob("*.mcap")), res / name)
    for option in ("--force", "--resume", "--list"):
        if option != "--list":
            told = said("replay", res / name, "-o", res, option)
            assert f"{res} would replace the input {res / name}" in told
    # The same, by another input.
    if name != "results.mcap":
        told = said("replay", recording, "-o", res, "--force")
        assert f"{res / name.partition('/')[0]}" in told and "move it" in told


def test_the_current_folder_is_not_replaced(
    tmp_path: Path, recording: Path, said: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither it nor one around it: the shell would be left in a folder that is gone."""
    here = tmp_path / "dives" / "today"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    for target in (".", "", "..", here, "../today"):
        assert "is the current folder or holds it" in said("replay", recording, "-o", target)
    command = ["replay", str(recording), "-o", "res"]
    assert main([*command, "--jobs", "1"]) == 0
    # Nor is a result unasked.
    assert "--force" in said(*command, "--every", "3")
    assert main([*command, "--every", "3", "--jobs", "1", "--force"]) == 0
    assert len(list(read_rows(here / "res" / "frames.csv"))) == 2


def test_a_folder_with_recording_and_result_is_kept(
    res: Path, recording: Path, said: Callable[..., str]
) -> None:
    bag = shutil.copytree(recording, res / "dive")
    assert "would replace the input" in said("replay", bag, "-o", res, "--force")
    assert f"{res / 'dive'} is not a result" in said("replay", recording, "-o", res, "--force")
    bag.rename(res.parent / "dive")
    fit = res / "fit_sensor.json"
    fit.write_text('{"/**": {"ros__parameters": {"rectify": false}}}')
    told = said("replay", recording, "-o", res, "--force", "--params-file", fit)
    assert f"replace the input {fit}" in told


@pytest.mark.parametrize("place", ["res", "res.partial", "res.partial.old"])
@pytest.mark.parametrize("marked", [True, False])
def test_foreign_files_are_kept(
    place: str, marked: bool, res: Path, recording: Path, said: Callable[..., str]
) -> None:
    folder = res.rename(res.with_name(place))
    if not marked:
        (folder / "replay.json").unlink()
    # A complete result is not touched by --resume.
    options = ["--force"] if place == "res" else ["--force", "--resume"]
    for entry in ("notes.txt", "results/notes.txt", "dives", "frames.nc"):
        planted = folder / entry
        planted.parent.mkdir(exist_ok=True)
        if entry == "frames.nc":
            planted.symlink_to(recording / "metadata.yaml")
        elif entry == "dives":
            planted.mkdir()
        else:
            planted.write_text("mine")
        for option in options:
            told = said("replay", recording, "-o", res.with_name("res"), option)
            assert f"{planted} is not" in told if marked else f"{folder} exists already" in told
            assert marked or "is no replay" in told
            assert "another name" in told
        shutil.rmtree(planted) if planted.is_dir() else planted.unlink()


@pytest.mark.parametrize("target", ["res", "notes.txt", "nowhere", "link"])
def test_a_link_is_neither_replaced_nor_followed(
    target: str, res: Path, recording: Path, said: Callable[..., str]
) -> None:
    (res.parent / "notes.txt").write_text("mine")
    link = res.parent / "link"
    link.symlink_to(target)
    told = said("replay", recording, "-o", link, "--force")
    assert f"{link} is a symbolic link: give the folder" in told


def test_hidden_folders_beside_a_result_are_kept(
    res: Path, recording: Path, tmp_path: Path
) -> None:
    foreign = [tmp_path / ".res.mine.partial", tmp_path / HIDDEN.format("res")]
    for folder in foreign:
        folder.mkdir()
        (folder / "notes.txt").write_text("mine")
    (foreign[1] / "replay.json").write_text("{}")
    left = shutil.copytree(res, tmp_path / HIDDEN.format("res").replace("0", "f"))
    before = {path: content for path, content in files(tmp_path).items() if path in foreign}
    assert main(["replay", str(recording), "-o", str(res), "--force", "--jobs", "1"]) == 0
    now = files(tmp_path)
    assert {path: now[path] for path in before} == before
    # An old result that a run did not come to remove.
    assert not left.exists()


@pytest.mark.parametrize("force", [False, True])
def test_a_folder_that_comes_under_the_targets_name_is_kept(
    force: bool, made: Path, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    if force:
        shutil.copytree(made / "res", out)
    close = FrameRecorder.close

    def plant(self: FrameRecorder, provenance: Any) -> None:
        out.mkdir(exist_ok=True)
        (out / "notes.txt").write_text("mine")
        close(self, provenance)

    command = ["replay", str(recording), "-o", str(out), "--jobs", "1"]
    with monkeypatch.context() as patch:
        patch.setattr(FrameRecorder, "close", plant)
        assert main([*command, *["--force"][:force]]) == 2
    told = capsys.readouterr().err
    assert f"the result is in {out}.partial" in told and str(out) in told
    assert (out / "notes.txt").read_text() == "mine"
    assert len(list(read_rows(tmp_path / "out.partial" / "frames.csv"))) == 4
    out.rename(tmp_path / "elsewhere")
    assert main([*command, "--resume"]) == 0
    assert "4 of them from before" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {"out", "elsewhere"}


@pytest.mark.parametrize("names", [
    ["transects.json"], ["frames.csv"], ["replay.json"], ["index.html"], ["frames.nc"],
    ["dive", "dive.partial"], ["dive", "dive.partial.old"],
])
def test_recordings_named_as_products_are_refused_before(
    names: list[str], recording: Path, tmp_path: Path, said: Callable[..., str]
) -> None:
    bags = [shutil.copytree(recording, tmp_path / "bags" / name) for name in [*names, "other"]]
    for option in ((), ("--force",), ("--resume",)):
        told = said("replay", *bags, "-o", tmp_path / "out", *option)
        assert f"a bag is named {names[-1]}, " in told
    assert not (tmp_path / "out").exists()


def test_a_day_is_called_one_and_is_not_replaced_by_one_recording(
    day: Path, recording: Path, tmp_path: Path, said: Callable[..., str]
) -> None:
    for option in ((), ("--force",), ("--resume",)):
        told = said("replay", recording, "-o", day, *option)
        assert f"{day} has the results of several recordings: give another name" in told
    # Those of others are not replaced unasked either.
    bags = [shutil.copytree(recording, tmp_path / name) for name in ("three", "four")]
    assert "--force to replace" in said("replay", *bags, "-o", day)
    inner = day / "one" / "results.mcap"
    assert "replace the input" in said("replay", inner, "-o", day, "--force")
    assert not (day / "replay.json").exists() and (day / "one").exists()


def test_enhance_asks_and_leaves_others_files_alone(
    pair: list[str], tmp_path: Path, said: Callable[..., str]
) -> None:
    out = tmp_path / "out"
    foreign = [out / name for name in (
        "notes.txt", ".mine.partial", ".0123456789ab.partial/notes.txt",
        ".0123456789ac.partial/.uw_visibility", ".0123456789ac.partial/notes.txt")]
    for file in foreign:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("mine")
    command = ["enhance", *pair, "-o", str(out)]
    # A killed run's.
    left = out / ".0123456789ad.partial"
    left.mkdir()
    for name in (".uw_visibility", "overview.png", ".range.pfm.0123456789ab.partial"):
        (left / name).write_text("")
    assert main(command) == 0
    assert not left.exists()
    assert "exists already: give another name, or --force" in said(*command)
    assert main([*command, "--force"]) == 0
    assert all(file.read_text() == "mine" for file in foreign)
    # What only has the name of a product is not replaced.
    (out / "report.json").write_text('{"status": "mine"}')
    assert f"{out / 'report.json'} exists already and is not of" in said(*command, "--force")
    (out / "report.json").unlink()
    assert "not of a result of enhance" in said(*command, "--force")


def test_enhance_does_not_write_over_its_inputs(
    pair: list[str], tmp_path: Path, said: Callable[..., str]
) -> None:
    out = tmp_path / "out"
    assert main(["enhance", *pair, "-o", str(out)]) == 0
    left = out / "left_enhanced.png"
    told = said("enhance", left, *pair[1:], "-o", out, "--force")
    assert f"would replace the input {left}" in told
    (tmp_path / "link").symlink_to(out)
    linked = tmp_path / "link" / left.name
    assert "would replace the input" in said("enhance", linked, *pair[1:], "-o", out, "--force")


def test_what_comes_under_the_name_of_a_product_is_kept_and_the_results_too(
    pair: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from uw_visibility.commands import enhance

    report = enhance.frame_report

    def plant(*arguments: Any) -> Any:
        (tmp_path / "out" / "overview.png").write_text("mine")
        return report(*arguments)

    monkeypatch.setattr(enhance, "frame_report", plant)
    out = tmp_path / "out"
    assert main(["enhance", *pair, "-o", str(out), "--force"]) == 2
    assert "the results are in" in capsys.readouterr().err
    assert (out / "overview.png").read_text() == "mine"
    (kept,) = [path for path in out.iterdir() if path.is_dir()]
    assert (kept / "report.json").is_file()


def test_simulate_replaces_no_recording_of_a_vehicle(
    recording: Path, tmp_path: Path, said: Callable[..., str]
) -> None:
    dive = shutil.copytree(recording, tmp_path / "bag")
    command = ["simulate", "--frames", "1", "--width", "96", "--height", "72", "--force", "-o"]
    assert "not a bag that this program wrote" in said(*command, dive)
    simulated = tmp_path / "simulated"
    assert main([*command, str(simulated)]) == 0
    for name in ("notes.txt", "dive.mcap"):
        (simulated / name).write_text("mine")
        assert f"{simulated / name} is not a result" in said(*command, simulated)
        (simulated / name).unlink()
    hidden = tmp_path / HIDDEN.format("simulated")
    (hidden / "simulated").mkdir(parents=True)
    (hidden / "simulated" / "simulated.mcap").write_text("mine")
    assert main([*command, str(simulated)]) == 0
    assert (hidden / "simulated" / "simulated.mcap").read_text() == "mine"


def test_calibrate_replaces_its_own_files_only(
    recording: Path, tmp_path: Path, said: Callable[..., str]
) -> None:
    bag = shutil.copytree(recording, tmp_path / "dive")
    file = next(bag.glob("*.mcap"))
    assert "would replace the input" in said("calibrate", file, "-o", file, "--force")
    for foreign in (file, bag / "metadata.yaml"):
        assert "is not of a calibration" in said("calibrate", bag, "-o", foreign, "--force")
    yaml = tmp_path / "camera.yaml"
    yaml.write_text("# mine\n")
    assert "is not of a calibration" in said("calibrate", bag, "-o", yaml, "--force")
    words = ("calibrate", bag, "--params-file", yaml, "-o", yaml, "--force")
    assert "would replace the input" in said(*words)
    picture = tmp_path / "lamps.png"
    picture.write_text("mine")
    assert "lamps.png exists already and is not of" in said(
        "calibrate", "--lighting", bag, "-o", picture.with_suffix(".yaml"), "--force")


@pytest.mark.parametrize("name", ["node.log", "frames.csv", "frame_001.png", "transect/dive.mcap"])
def test_the_demonstration_asks_and_replaces_its_own_only(
    name: str, tmp_path: Path, said: Callable[..., str]
) -> None:
    pytest.importorskip("rclpy")
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    for option in ((), ("--force",)):
        told = said("demo", "-o", tmp_path, *option)
        assert f"{tmp_path / name.partition('/')[0]} exists already" in told


def test_evaluate_leaves_others_files_alone(tmp_path: Path, said: Callable[..., str]) -> None:
    (tmp_path / "evaluation.json").write_text("{}")
    (tmp_path / "cases.csv").symlink_to("notes.txt")
    (tmp_path / "notes.txt").write_text("mine")
    assert "cases.csv exists already" in said("evaluate", "--quick", "-o", tmp_path, "--force")
