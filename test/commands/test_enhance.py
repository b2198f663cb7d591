# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility enhance`: files, report, exit codes."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from PIL import ExifTags, Image
from scenes import blurred, codes, stereo_pair, texture

from uw_visibility.cli import main
from uw_visibility.stereo.rig import StereoRig

NUMBERS = ("--focal-length", "400", "--baseline", "0.12")
OUTPUTS = {
    "left_enhanced.png", "right_enhanced.png", "disparity.pfm", "confidence.pfm",
    "disparity_filled.pfm",
    "range.pfm", "report.json", "overview.png",
}
DISPARITY = 12
PROJECTIONS = {
    "P1": [[400.0, 0, 80, 0], [0, 400.0, 60, 0], [0, 0, 1, 0]],
    "P2": [[400.0, 0, 80, -48.0], [0, 400.0, 60, 0], [0, 0, 1, 0]],
}
Pair = Sequence[NDArray[Any]]


def make_pair(dtype: type = np.uint8, width: int = 160, height: int = 120) -> Pair:
    """Return a fronto-parallel, textured scene, BGR."""
    scene = blurred(texture((height, width + DISPARITY, 3), 7), 0.8)
    return stereo_pair(codes(scene * np.array([0.8, 0.7, 0.4]), dtype), DISPARITY)


def save(folder: Path, pair: Pair) -> tuple[str, str]:
    paths = folder / "left.png", folder / "right.png"
    for path, image in zip(paths, pair, strict=True):
        cv2.imwrite(str(path), image)
    return str(paths[0]), str(paths[1])


def read(path: Path) -> NDArray[Any]:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None, path
    return np.asarray(image)


def report_of(folder: Path) -> dict[str, Any]:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} in report.json")

    text = (folder / "report.json").read_text(encoding="utf-8")
    report: dict[str, Any] = json.loads(text, parse_constant=refuse)
    return report


def check_outputs(folder: Path, image: NDArray[Any]) -> dict[str, Any]:
    """Check what every successful run leaves, and return the report."""
    assert {path.name for path in folder.iterdir()} == OUTPUTS
    for side in ("left", "right"):
        enhanced = read(folder / f"{side}_enhanced.png")
        assert (enhanced.shape, enhanced.dtype) == (image.shape, image.dtype)
    overview = read(folder / "overview.png")
    height, width = image.shape[:2]
    assert (overview.shape[1:], overview.dtype) == ((3 * width, 3), np.uint8)
    # Between the titles, and the scale and what was assumed.
    line = round(16 * max(width / 480, 1.0))
    assert overview.shape[0] >= height + 3 * line
    overview = overview[line : line + height]
    before = (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image
    assert (overview[:, :width] == (before if image.ndim == 3 else before[..., None])).all()
    for name in ("disparity", "disparity_filled", "range"):
        values = read(folder / f"{name}.pfm")
        assert values.shape == image.shape[:2]
        assert values.dtype == np.float32
        assert not np.isnan(values).any()
        if name != "disparity":
            assert np.isfinite(values).all()
    report = report_of(folder)
    assert set(report) == {
        "status", "step1", "step2", "clear_water_attenuation", "mean_attenuation",
        "mean_attenuation_stddev", "visibility_distance", "visibility_distance_stddev",
        "visibility_distance_low", "visibility_distance_high", "depth", "depth_stddev",
        *(f"{name}{end}" for name in (
            "black_disc_visibility", "secchi_depth", "diffuse_attenuation_490")
          for end in ("_low", "", "_high")),
        "matched_fraction", "timing_ms", "white", "channels",
    }
    assert set(report["step1"]) == {"attenuation", "ambient_light", "support_points", "coverage"}
    assert set(report["step2"]) == {
        "attenuation", "attenuation_stddev", "ambient_light", "ambient_light_stddev",
        "iterations", "bins",
    }
    assert set(report["matched_fraction"]) == {"original", "enhanced"}
    assert report["timing_ms"]["total"] > 0.0
    return report


@pytest.fixture
def refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """Run `enhance` on what must be refused; return the sentence."""

    def run(*words: str) -> str:
        code = main(["enhance", *words, "-o", str(tmp_path / "out")])
        captured = capsys.readouterr()
        assert code == 2, captured.err
        assert captured.out == ""
        assert captured.err.startswith("uw_visibility: ")
        assert captured.err.count("\n") == 1
        assert "Traceback" not in captured.err
        assert not (tmp_path / "out" / "report.json").exists()
        return captured.err

    return run


@pytest.fixture
def pair(tmp_path: Path) -> tuple[str, str]:
    return save(tmp_path, make_pair())


def test_the_command_enhances_a_pair(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = make_pair()
    assert main([
        "enhance", *save(tmp_path, images), *NUMBERS, "--principal-point", "80", "60",
        "--max-disparity", "32", "-o", str(tmp_path / "deep" / "out")]) == 0
    assert str(tmp_path / "deep" / "out") in capsys.readouterr().out
    report = check_outputs(tmp_path / "deep" / "out", images[0])
    disparity = read(tmp_path / "deep" / "out" / "disparity.pfm")
    matched = np.isfinite(disparity)
    assert matched.mean() == pytest.approx(report["matched_fraction"]["enhanced"])
    assert matched.mean() > 0.6
    assert (np.abs(disparity[matched] - DISPARITY) < 1.0).mean() > 0.9
    # f T / d in the middle, where the line of sight is the optical axis.
    distance = read(tmp_path / "deep" / "out" / "range.pfm")[55:65, 75:85]
    assert np.median(distance) == pytest.approx(400 * 0.12 / DISPARITY, rel=0.05)


def test_the_transfer_of_the_command_line_goes_before_that_of_the_file(
    tmp_path: Path, pair: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    params = tmp_path / "camera.yaml"
    params.write_text(yaml.safe_dump({"/**": {"ros__parameters": {
        "camera": {"transfer": "linear", "white_reference": [1.0, 0.8, 0.6]}}}}), encoding="utf-8")
    told = []
    for name, words in (("none", ()), ("file", ("--params-file", str(params))), (
            "line", ("--params-file", str(params), "--transfer", "srgb"))):
        assert main(["enhance", *pair, *NUMBERS, *words, "-o", str(tmp_path / name)]) == 0
        said = capsys.readouterr()
        told.append(said.out)
        overridden = f"--transfer srgb is used, not the linear of {params}" in said.err
        assert overridden is (name == "line")
    assert "transfer linear (assumed; --transfer srgb for video)" in told[0]
    assert "transfer linear, white at the surface 1 : 0.8 : 0.6, " in told[1]
    assert "transfer srgb, " in told[2]
    linear, srgb = (read(tmp_path / name / "left_enhanced.png") for name in ("file", "line"))
    assert linear.shape == srgb.shape


def test_a_jpeg_that_viewers_turn_is_told_and_used_as_stored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    paths = [tmp_path / f"{side}.jpg" for side in ("left", "right")]
    for path, image, written in zip(paths, make_pair(), (exif, Image.Exif()), strict=True):
        Image.fromarray(image).save(path, exif=written)
    assert main(["enhance", *map(str, paths), *NUMBERS, "-o", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    assert f"{paths[0]} is turned by viewers" in said
    assert f"{paths[1]} is turned" not in said
    assert read(tmp_path / "out" / "left_enhanced.png").shape == (120, 160, 3)


def test_a_jpeg_without_a_transfer_asks_for_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(tmp_path / f"{side}.jpg") for side in ("left", "right")]
    for path, image in zip(paths, make_pair(), strict=True):
        cv2.imwrite(path, image)
    for words, asked in (((), True), (("--transfer", "srgb"), False)):
        assert main([
            "enhance", *paths, *NUMBERS, *words, "--force", "-o", str(tmp_path / "out")]) == 0
        assert ("give --transfer srgb" in capsys.readouterr().err) is asked


@pytest.mark.parametrize("kind", ["grey", "16 bit"])
def test_what_cannot_be_assessed_is_null_with_a_status(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    left, right = make_pair(np.uint16 if kind == "16 bit" else np.uint8)
    if kind == "grey":
        left, right = left[:, :, 1], right[:, :, 1]
    arguments = [*save(tmp_path, (left, right)), *NUMBERS, "-o", str(tmp_path / "out")]
    assert main(["enhance", *arguments]) == 0
    report = check_outputs(tmp_path / "out", left)
    # One plane at one range tells nothing of the water, whatever its colour.
    assert report["status"] == ("no colour" if kind == "grey" else "range spread too small")
    said = capsys.readouterr().out
    assert ("needs a colour camera" if kind == "grey" else "Tilt the camera") in said
    assert "closest to what divers" not in said
    assert report["visibility_distance"] is None
    assert report["depth"] is None
    assert report["matched_fraction"]["enhanced"] > 0.6


@pytest.mark.parametrize(
    ("value", "reason"), [(90, "no texture"), (0, "too dark"), (255, "saturated")]
)
def test_images_that_show_nothing_are_refused(
    refused: Callable[..., str], tmp_path: Path, value: int, reason: str
) -> None:
    left, right = save(tmp_path, [np.full_like(image, value) for image in make_pair()])
    sentence = refused(left, right, *NUMBERS)
    assert left in sentence
    assert reason in sentence


def test_calibration_and_numbers_say_the_same(
    tmp_path: Path, pair: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "pair.json").write_text(json.dumps(PROJECTIONS), encoding="utf-8")
    for side, projection in zip(("left", "right"), PROJECTIONS.values(), strict=True):
        content = {
            "image_width": 160, "image_height": 120, "distortion_model": "plumb_bob",
            "camera_matrix": {"data": [400.0, 0, 80, 0, 400.0, 60, 0, 0, 1]},
            "distortion_coefficients": {"data": [0.0] * 5},
            "rectification_matrix": {"data": [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0]},
            "projection_matrix": {"data": [value for row in projection for value in row]},
        }
        (tmp_path / f"{side}.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    left, right, both = (str(tmp_path / n) for n in ("left.yaml", "right.yaml", "pair.json"))
    ways = (
        [*pair, *NUMBERS, "--principal-point", "80", "60"],
        ["--calibration", both, *pair],
        ["--calibration", left, right, *pair],
        [*pair, "--calibration", left, "--calibration", right],
    )
    ranges = []
    for number, way in enumerate(ways):
        out = tmp_path / f"out{number}"
        assert main(["enhance", *way, "-o", str(out)]) == 0
        ranges.append(read(out / "range.pfm"))
        told = (
            f"{both} has no width and height: taken for images of 160x120 pixels, as these are, "
            "whose middle should be near its principal point, 80 60")
        assert (told in capsys.readouterr().err) is (both in way)
    for other in ranges[1:]:
        np.testing.assert_array_equal(other, ranges[0])


def test_what_matched_in_noise_is_not_filled(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    noisy = [codes(side / 255.0 + random.normal(0.0, 0.1, side.shape)) for side in make_pair()]
    out = tmp_path / "out"
    assert main(["enhance", *save(tmp_path, noisy), *NUMBERS, "-o", str(out)]) == 0
    disparity, filled = read(out / "disparity.pfm"), read(out / "disparity_filled.pfm")
    matched = np.isfinite(disparity)
    assert 0.5 < matched.mean() < 1.0
    np.testing.assert_array_equal(filled[matched], disparity[matched])
    rig = StereoRig(400.0, 0.12, (79.5, 59.5))
    np.testing.assert_allclose(
        read(out / "range.pfm")[matched], rig.range_from_disparity(disparity)[matched], rtol=1e-5)


def test_the_option_overrides_the_parameter_file(tmp_path: Path, pair: tuple[str, str]) -> None:
    path = tmp_path / "parameters.yaml"
    path.write_text("/**: {ros__parameters: {stereo: {max_disparity: 8}}}", encoding="utf-8")
    fractions = []
    for number, extra in enumerate(([], ["--max-disparity", "32"])):
        out = tmp_path / f"out{number}"
        words = [*pair, *NUMBERS, "--params-file", str(path), *extra, "-o", str(out)]
        assert main(["enhance", *words]) == 0
        found = read(out / "disparity.pfm")
        fractions.append((np.abs(found - DISPARITY) < 1.0).mean())
    assert fractions[0] == 0.0
    assert fractions[1] > 0.6


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ((), "--focal-length"),
        (("--focal-length", "400"), "--baseline"),
        (("--focal-length", "far", "--baseline", "1"), "--focal-length"),
        ((*NUMBERS, "--focal-length", "nan"), "focal length"),
        ((*NUMBERS, "--baseline", "-1"), "baseline"),
        ((*NUMBERS, "--calibration", "pair.json"), "--calibration"),
        ((*NUMBERS, "--max-disparity", "-1"), "--max-disparity"),
        ((*NUMBERS, "--max-disparity", "1.5"), "--max-disparity"),
        ((*NUMBERS, "--principal-point", "nan", "0"), "principal point"),
        ((*NUMBERS, "--principal-point", "80"), "--principal-point"),
        ((*NUMBERS, "--max-disparty", "64"), "--max-disparty"),
        (("--calibration", "absent.json"), "absent.json"),
        ((*NUMBERS, "--params-file", "absent.yaml"), "absent.yaml"),
    ],
)
def test_options_that_cannot_be_used_are_named(
    refused: Callable[..., str], pair: tuple[str, str], words: tuple[str, ...], named: str
) -> None:
    assert named in refused(*pair, *words)


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("stereo: {max_disparty: 64}", "stereo.max_disparity"),
        ("stereo: {max_disparity: many}", "stereo.max_disparity"),
        ("rectfy: true", "rectify"),
    ],
)
def test_parameters_that_cannot_be_used_are_named(
    refused: Callable[..., str], tmp_path: Path, pair: tuple[str, str], line: str, named: str
) -> None:
    path = tmp_path / "parameters.yaml"
    path.write_text(f"/**: {{ros__parameters: {{{line}}}}}", encoding="utf-8")
    sentence = refused(*pair, *NUMBERS, "--params-file", str(path))
    assert named in sentence
    assert str(path) in sentence


def test_images_that_cannot_be_used_are_named(
    refused: Callable[..., str], tmp_path: Path, pair: tuple[str, str]
) -> None:
    left, right = pair
    (tmp_path / "text.png").write_text("no image", encoding="utf-8")
    for name in ("absent.png", "text.png"):
        assert name in refused(left, str(tmp_path / name), *NUMBERS)
    other = tmp_path / "other.png"
    image = read(Path(left))
    for different in (image[:, :-2], image[:, :, 0], image.astype(np.uint16)):
        cv2.imwrite(str(other), different)
        sentence = refused(str(other), right, *NUMBERS)
        assert str(other) in sentence
        assert right in sentence


def test_small_images_are_refused(refused: Callable[..., str], tmp_path: Path) -> None:
    left, right = save(tmp_path, make_pair(width=48, height=32))
    sentence = refused(left, right, *NUMBERS)
    assert left in sentence
    assert "48x32" in sentence


def test_a_calibration_of_other_images_is_refused(
    refused: Callable[..., str], tmp_path: Path, pair: tuple[str, str]
) -> None:
    path = tmp_path / "pair.json"
    path.write_text(json.dumps({**PROJECTIONS, "width": 320, "height": 240}))
    sentence = refused(*pair, "--calibration", str(path))
    assert str(path) in sentence
    assert "320x240" in sentence
    assert "160x120" in sentence


def test_a_folder_that_cannot_be_made_is_named(
    tmp_path: Path, pair: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(pair[0]) / "out"
    assert main(["enhance", *pair, *NUMBERS, "-o", str(folder)]) == 2
    assert str(folder) in capsys.readouterr().err


def test_a_failure_inside_is_one_sentence_and_another_code(
    tmp_path: Path, pair: tuple[str, str], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise RuntimeError("something\nbroke")

    monkeypatch.setattr("uw_visibility.pipeline.pipeline.Pipeline.process", fail)
    words = ["enhance", *pair, *NUMBERS, "-o", str(tmp_path / "out")]
    assert main(words) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "RuntimeError: something broke" in error
    assert main([*words, "--debug"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_real_pairs_are_matched(shared_data: Path, tmp_path: Path) -> None:
    data = shared_data / "underwater" / "bermuda"
    left = data / "left_04.png"
    words = [
        str(left), str(data / "right_04.png"),
        "--calibration", str(data / "calibration.json"), "-o", str(tmp_path / "out"),
    ]
    assert main(["enhance", *words]) == 0
    report = check_outputs(tmp_path / "out", read(left))
    assert report["matched_fraction"]["enhanced"] > 0.5
    assert report["step1"]["support_points"] > 20
