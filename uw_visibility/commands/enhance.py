# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility enhance`: one stereo pair from files."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uw_visibility.commands.options import add_camera_options, read_params_file
from uw_visibility.config.assumptions import ASK_TRANSFER, assumptions
from uw_visibility.config.files import Products, gathered, refuse_inputs, sole_writer, write_whole
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError, naming, refusing
from uw_visibility.replay.progress import compiling, say, tell
from uw_visibility.status import Status

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from uw_visibility.pipeline.pipeline import FrameResult
    from uw_visibility.stereo.rig import StereoRig
    from uw_visibility.water.meaning.derived import DerivedModel, DerivedQuantities

REPORT = "report.json"
MAPS = ("disparity.pfm", "confidence.pfm", "disparity_filled.pfm", "range.pfm")
PRODUCTS = Products(
    REPORT, ("overview.png", "left_enhanced.png", "right_enhanced.png", *MAPS),
    "not of a result of enhance", keys=('"matched_fraction"',))
COLOURS = ("red", "green", "blue")
TURNED = (
    "{} is turned by viewers (EXIF orientation), but used as stored: give the calibration, and "
    "left and right, of the stored pixels, or turn the pixels first")
UNSIZED = (
    "calibration {} has no width and height: taken for images of {}x{} pixels, as these are, whose "
    "middle should be near its principal point, {:g} {:g}")
LOSSY = (".jpg", ".jpeg")

HELP = "one pair from files"
DESCRIPTION = """\
Assess the water, enhance the images and match one rectified stereo pair.

Give the cameras as numbers (--focal-length, --baseline) or as --calibration:
  one JSON file      P1 and P2, 3 by 4, of the rectified pair
  two YAML files     of the left and the right camera, as camera_calibration writes them:
                     --calibration left.yaml right.yaml
Images have 8 or 16 bit, are in colour or grey, and rectified."""

EPILOG = """\
written to DIR:
  overview.png           the left image as recorded and without the water, its range in
                         colours with a scale in metres, and what was assumed
  left_enhanced.png, right_enhanced.png   the images without the water
  disparity.pfm          matched pixels, px; inf = unmatched
  confidence.pfm         probability that disparity is within 1 px; 0 = unmatched
  disparity_filled.pfm   disparity with gaps filled, as for colour, px; 0 = unknown
  range.pfm              distance along the line of sight, m, of disparity_filled;
                         0 = unknown or infinite
  report.json            the estimates; null = not assessable, status has the reason

Other files in DIR are left alone. --force replaces the files of an earlier run.

exit code: 0 done, 1 internal error, 2 unusable input or options"""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("left", metavar="LEFT", type=Path, help="left image")
    parser.add_argument("right", metavar="RIGHT", type=Path, help="right image")
    parser.add_argument("--focal-length", metavar="PX", type=float, help="focal length, px")
    parser.add_argument("--baseline", metavar="M", type=float, help="distance of the cameras, m")
    parser.add_argument(
        "--principal-point", metavar=("CX", "CY"), type=float, nargs=2,
        help="principal point, px (default: centre of the image)",
    )
    add_camera_options(parser, "the numbers")
    parser.add_argument(
        "--max-disparity", metavar="PX", type=int,
        help="largest disparity searched, px (parameter stereo.max_disparity)",
    )
    parser.add_argument(
        "-o", "--output", metavar="DIR", type=Path, required=True,
        help="folder for the results; created if missing",
    )
    parser.add_argument(
        "--force", action="store_true", help="replace the results of an earlier run")


def run(arguments: argparse.Namespace) -> None:
    """Run the sub-command.

    Raises `InputError` if an option, a file or the pair of images cannot be used.
    """
    config, told = _read_config(arguments)
    left, right = _read_pair(arguments.left, arguments.right)
    rig = _make_rig(arguments, left.shape)
    _prepare_folder(arguments)
    # Imported late: compiled modules load slowly, and bad input is refused before.
    from uw_visibility.replay.report.meaning import meaning
    from uw_visibility.replay.report.sentences import definition
    from uw_visibility.water.meaning.derived import DerivedModel

    with sole_writer(arguments.output):
        with naming(f"{arguments.left}, {arguments.right}"):
            result = _process(rig, config, left, right, arguments.left)
        with gathered(arguments.output, PRODUCTS, force=arguments.force) as folder:
            assumed = assumptions(config.to_parameters(), told, [rig.baseline])
            report = _write(
                folder, result, DerivedModel(config), left, assumed, rig.range_error())
    say(_summary(report, arguments.output))
    told_distance = report["visibility_distance"] is not None
    say(definition(config.assessment.contrast) if told_distance else meaning(report["status"]))
    say(assumed)
    if "camera.transfer" not in told and arguments.left.suffix.lower() in LOSSY:
        say(ASK_TRANSFER, error=True)


def _read_config(arguments: argparse.Namespace) -> tuple[PipelineConfig, Collection[str]]:
    """Return the parameters, options overriding the file, and the names of those given."""
    values = read_params_file(arguments.params_file, arguments.transfer)
    if arguments.max_disparity is not None:
        values["stereo.max_disparity"] = arguments.max_disparity
    # The file was checked when it was read.
    with naming("--max-disparity"):
        config = PipelineConfig.from_parameters(values)
    return config, values


def _read_pair(left_path: Path, right_path: Path) -> tuple[NDArray[Any], NDArray[Any]]:
    from uw_visibility.images.files import is_turned, read_image
    from uw_visibility.images.pair import check_pair

    left, right = read_image(left_path), read_image(right_path)
    for path in filter(is_turned, (left_path, right_path)):
        say(TURNED.format(path), error=True)
    with naming(f"{left_path}, {right_path}"):
        check_pair(left, right)
    return left, right


def _make_rig(arguments: argparse.Namespace, shape: tuple[int, ...]) -> StereoRig:
    from uw_visibility.commands.calibration_file import read_rig
    from uw_visibility.stereo.rig import StereoRig

    numbers = {
        "--focal-length": arguments.focal_length,
        "--baseline": arguments.baseline,
        "--principal-point": arguments.principal_point,
    }
    given = [option for option, value in numbers.items() if value is not None]
    files = arguments.calibration
    if files and given:
        raise InputError(f"give either --calibration or {given[0]}, not both")
    if files:
        rig, size = read_rig(files)
        width, height = size or (shape[1], shape[0])
        if size is None:
            say(UNSIZED.format(files[0], width, height, *rig.principal_point), error=True)
        if (width, height) != (shape[1], shape[0]):
            raise InputError(
                f"calibration {files[0]} is for images of {width}x{height} pixels, "
                f"{arguments.left} has {shape[1]}x{shape[0]}: give the calibration of these images"
            )
        return rig
    missing = [o for o in ("--focal-length", "--baseline") if numbers[o] is None]
    if missing:
        raise InputError(
            f"{' and '.join(missing)} missing: give --focal-length and --baseline, or --calibration"
        )
    centre = arguments.principal_point or ((shape[1] - 1) / 2, (shape[0] - 1) / 2)
    return StereoRig(arguments.focal_length, arguments.baseline, tuple(centre))


def _process(
    rig: StereoRig, config: PipelineConfig, left: NDArray[Any], right: NDArray[Any], path: Path
) -> FrameResult:
    from uw_visibility.images.jpeg import file_chroma
    from uw_visibility.pipeline.pipeline import Pipeline

    tell("preparing; the first run compiles, for a minute or two")
    pipeline = Pipeline(rig, config)
    chroma = file_chroma(path, left)
    # Otherwise the report's times would include compilation.
    with compiling():
        pipeline.warm_up((left.shape[0], left.shape[1]), left.dtype, compressed=chroma is not None)
    return pipeline.process(left, right, match_original=True, colour=chroma)


def _prepare_folder(arguments: argparse.Namespace) -> None:
    """Make the folder for the results, before the work."""
    folder = arguments.output
    refuse_inputs(
        [arguments.left, arguments.right, arguments.params_file, *arguments.calibration],
        [folder / name for name in (REPORT, *PRODUCTS.files)])
    with refusing(f"cannot make folder {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"cannot write to folder {folder}: give another one with -o")
    PRODUCTS.check_room(folder, force=arguments.force)


def _write(
    folder: Path, result: FrameResult, model: DerivedModel, left: NDArray[Any], assumed: str,
    range_error: float,
) -> dict[str, Any]:
    import numpy as np

    from uw_visibility.images.files import write_pfm, write_png
    from uw_visibility.images.overview import overview

    write_png(folder / "left_enhanced.png", result.left_enhanced)
    write_png(folder / "right_enhanced.png", result.right_enhanced)
    write_png(folder / "overview.png", overview(
        left, result.left_enhanced, result.range, assumed, range_error))
    matched = np.where(np.isfinite(result.disparity), result.disparity, np.float32(np.inf))
    write_pfm(folder / "disparity.pfm", matched)
    if result.stereo.confidence is not None:
        write_pfm(folder / "confidence.pfm", result.stereo.confidence)
    for name, measured, filled in (
        ("disparity_filled", result.disparity, result.stereo.filled),
        ("range", result.range, result.stereo.filled_range),
    ):
        # Colour does without doubtful matches in noise, a user of the files not.
        values = np.where(np.isfinite(measured), measured, filled)
        known = np.isfinite(values)
        if not known.all():
            share = 1.0 - known.mean()
            print(f"{name}.pfm: {share:.1%} of the pixels are 0, unknown", file=sys.stderr)
        write_pfm(folder / f"{name}.pfm", np.where(known, values, np.float32(0)))
    report = frame_report(result, model.derive(result.water))
    text = json.dumps(report, indent=1, allow_nan=False)
    write_whole(folder / REPORT, text + "\n")
    return report


def _summary(report: dict[str, Any], folder: Path) -> str:
    from uw_visibility.replay.report.sentences import headline
    from uw_visibility.replay.results.synopsis import TOLD

    parts = [f"status: {report['status']}"]
    typical = {
        name: [report[f"{name}_low"], report[name], report[f"{name}_high"]]
        for name in TOLD if report[name] is not None}
    parts += [f"{each.title} {each.value}" for each in headline(typical, "")]
    for name, title, unit in (
        ("depth", "depth", "m"),
        ("mean_attenuation", "mean attenuation", "1/m"),
    ):
        if report[name] is not None:
            deviation = report[f"{name}_stddev"]
            band = "" if deviation is None else f" ± {deviation:.3g}"
            parts.append(f"{title} {report[name]:.3g}{band} {unit}")
    lost = [name for name, letter in zip(COLOURS, "RGB", strict=True)
            if letter not in report["channels"]]
    # If the estimate was refused, channels may be missing for other reasons.
    if report["status"] == str(Status.OK) and lost:
        parts.append(f"no light is left in {' and '.join(lost)}")
    parts.append(f"matched {report['matched_fraction']['enhanced']:.1%}")
    return f"{', '.join(parts)}; written to {folder}"


def frame_report(result: FrameResult, derived: DerivedQuantities) -> dict[str, Any]:
    """Return the contents of `report.json` from a result and its derived quantities.

    Only numbers, strings, lists and dicts. Values that are not assessable are None: single
    channels in a list, or the whole list if no channel is assessable.
    """
    visibility = result.visibility
    statuses = (result.status, visibility.status, visibility.depth_status)
    return {
        # The first reason why a value is not assessable.
        "status": str(next((s for s in statuses if s is not Status.OK), Status.OK)),
        "step1": {
            "attenuation": _channels(result.coarse_water.attenuation),
            "ambient_light": _channels(result.coarse_water.ambient_light),
            "support_points": int(result.stereo.support_points),
            "coverage": _number(result.stereo.coverage),
        },
        "step2": {
            "attenuation": _channels(result.water.attenuation),
            "attenuation_stddev": _channels(result.water.attenuation_stddev),
            "ambient_light": _channels(result.water.ambient_light),
            "ambient_light_stddev": _channels(result.water.ambient_light_stddev),
            "iterations": int(result.water.iterations),
            "bins": int(result.water.bins),
        },
        "clear_water_attenuation": _channels(result.clear_water_attenuation),
        # Channels that have light, such as "GB" if the water absorbed red.
        "channels": visibility.channels,
        "mean_attenuation": _number(visibility.mean_attenuation),
        "mean_attenuation_stddev": _number(visibility.mean_attenuation_stddev),
        "visibility_distance": _number(visibility.distance),
        "visibility_distance_stddev": _number(visibility.distance_stddev),
        "visibility_distance_low": _number(visibility.distance_low),
        "visibility_distance_high": _number(visibility.distance_high),
        **{
            f"{name}{end}": _number(value)
            for name in ("black_disc_visibility", "secchi_depth", "diffuse_attenuation_490")
            for end, value in zip(("_low", "", "_high"), derived.interval(name), strict=True)
        },
        "depth": _number(visibility.depth),
        "depth_stddev": _number(visibility.depth_stddev),
        "white": None if result.images.scene_light is None else {
            "scene_light": _channels(result.images.scene_light),
            "from_camera": _number(result.images.balanced),
        },
        "matched_fraction": {
            "original": _number(result.stereo.matched_fraction_original),
            "enhanced": _number(result.stereo.matched_fraction),
        },
        "timing_ms": {stage: round(time, 3) for stage, time in result.timing_ms.items()},
    }


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _channels(values: Iterable[float]) -> list[float | None] | None:
    channels = [_number(value) for value in values]
    return None if all(value is None for value in channels) else channels
