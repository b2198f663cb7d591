# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility calibrate`: white reference and water type, or lamps, from recorded bags."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uw_visibility.commands.options import (
    add_recording_options,
    jobs,
    read_params_file,
    read_recording_options,
    reading,
)
from uw_visibility.config.files import Products, refuse_inputs, write_whole
from uw_visibility.errors import InputError, needing, printable
from uw_visibility.replay.progress import say

if TYPE_CHECKING:
    from uw_visibility.replay.calibration import CalibrationSeries
    from uw_visibility.water.lamps.calibration import LampCalibration
    from uw_visibility.water.meaning.calibration import Calibration

HELP = "white reference and water type, or lamps, from bags"
DESCRIPTION = """\
Find the parameters of camera and water that the depth estimate needs: the camera's
white (camera.white_reference) and the water type (assessment.water_type), from
recordings with a depth sensor over depths that differ by at least a metre.

With --lighting, find the vehicle's lamps instead: positions, axes and beams (lighting.*),
from recordings at night. Move slowly, so that frames overlap, and see the ground from
many distances; see docs/lamps.md."""

EPILOG = """\
written to YAML (without -o: to standard output): the parameters of --params-file, if
given, and those found; a parameter file for all commands and for the node.
Several BAGs are evaluated together: one camera with fixed white balance, in water of
one type. With --lighting and -o a picture is written beside YAML, as .png.

exit code: 0 done, 1 nothing in a bag can be read, or internal error, 2 unusable input or
options"""

SHOWN_TYPES = 5


def add_options(parser: argparse.ArgumentParser) -> None:
    add_recording_options(parser)
    parser.add_argument("-o", "--output", metavar="YAML", type=Path, help="file to write")
    parser.add_argument("--force", action="store_true", help="replace a file written by calibrate")
    parser.add_argument(
        "--lighting", action="store_true", help="find the vehicle's lamps instead")
    parser.add_argument(
        "--lamps", metavar="N", type=int,
        help="with --lighting: 1, 2 or 4 lamps at unknown positions (default: start from the lamps "
        "of --params-file)",
    )


def run(arguments: argparse.Namespace) -> None:
    _check_target(arguments)
    if arguments.lamps is not None and not arguments.lighting:
        raise InputError("--lamps is for --lighting: give both, or neither")
    from uw_visibility.replay.stores import recordings_here

    calibrate = _calibrate_lighting if arguments.lighting else _calibrate
    with recordings_here(arguments.bags) as arguments.bags:
        calibrate(arguments)


def _calibrate(arguments: argparse.Namespace) -> None:
    """Find white reference and water type."""
    with reading("calibrate"):
        from uw_visibility.replay.calibration import calibrate_recordings

        options = read_recording_options(arguments).with_one_thread()
        found, series = calibrate_recordings(arguments.bags, options, jobs=jobs(arguments))
    # Checked again: a file may have appeared meanwhile.
    _check_target(arguments)
    low, high = found.depth_range
    white = ", ".join(f"{value:.2g}" for value in found.best.white_reference_stddev)
    _write(
        arguments, found.parameters(), "White reference and water type by uw_visibility calibrate",
        f"{len(found.residuals)} frames at {low:.2f} to {high:.2f} m. Standard deviations of the "
        f"white reference: {white}. Depth against the sensor: {found.best.depth_rms:.2f} m rms.",
        _describe(found, series), series.damage,
    )


def _calibrate_lighting(arguments: argparse.Namespace) -> None:
    """Find positions, axes and beams of lamps."""
    output = arguments.output
    picture = None if output is None else output.with_suffix(".png")
    if picture is not None:
        if picture == output:
            raise InputError(f"the picture would replace {picture}: give -o another name")
        with needing("report", "the picture of the lamps", ", or leave out -o"):
            from uw_visibility.replay.lamp_calibration import draw_calibration
    with reading("calibrate"):
        from uw_visibility.replay.lamp_calibration import calibrate_lighting

        found, frames, damage = calibrate_lighting(
            arguments.bags, read_recording_options(arguments), arguments.lamps)
    # Checked again: a file may have appeared meanwhile.
    _check_target(arguments)
    if picture is not None:
        draw_calibration(picture, found)
    _write(
        arguments, found.parameters(), "Lamps by uw_visibility calibrate --lighting",
        f"{frames} frames.", _describe_lamps(found, frames), damage,
        "" if picture is None else f" and {picture}",
    )


def _write(
    arguments: argparse.Namespace, parameters: dict[str, Any], what: str, how: str, told: str,
    damage: list[str], more: str = "",
) -> None:
    """Write the parameters that were found, and print their description."""
    from uw_visibility.config.parameters import render_values

    names = printable(", ".join(bag.resolve().name for bag in arguments.bags))
    given = read_params_file(arguments.params_file)
    if arguments.transfer is not None:
        given["camera.transfer"] = arguments.transfer
    text = render_values(given | parameters, f"{what}, of {names}: {how}")
    # Standard output holds the file only.
    print(told, file=sys.stderr if arguments.output is None else sys.stdout)
    for note in damage:
        say(f"uw_visibility: warning: {note}", error=True)
    if arguments.output is None:
        print(text, end="")
        return
    write_whole(arguments.output, text)
    say(f"written to {arguments.output}{more}")


def _check_target(arguments: argparse.Namespace) -> None:
    """Refuse an output file that cannot be written, before the work."""
    path = arguments.output
    if path is None:
        return
    targets = [path, path.with_suffix(".png")] if arguments.lighting else [path]
    refuse_inputs([*arguments.bags, arguments.params_file, *arguments.calibration], targets)
    # A symbolic link stays; its target is replaced.
    real = Path(os.path.realpath(path))
    pictures = (escape(real.with_suffix(".png").name),) if arguments.lighting else ()
    Products(
        real.name, pictures, "not of a calibration", keys=("by uw_visibility calibrate",)
    ).check_room(real.parent, force=arguments.force)
    # Not resolved: a link that leads to itself raises.
    if not path.absolute().parent.is_dir():
        raise InputError(f"cannot write {path}: its folder is missing")


def _describe(found: Calibration, series: CalibrationSeries) -> str:
    """Return the calibration as text: values, certainty, and effect on depth."""
    import numpy as np

    low, high = found.depth_range
    lines = [
        f"{len(found.residuals)} of {len(series.estimates) + series.unusable} frames have an "
        f"estimate and a depth, {low:.2f} to {high:.2f} m",
        "",
        f"  {'water type':12}{'depth, rms (m)':>15}    white reference R G B",
    ]
    shown = found.candidates[:SHOWN_TYPES]
    if found.best not in shown:
        shown = (*shown, found.best)
    for candidate in shown:
        white = _with_stddev(candidate.white_reference, candidate.white_reference_stddev)
        mark = "*" if candidate is found.best else " "
        lines.append(
            f"{mark} {candidate.water_type:12}{candidate.depth_rms:15.2f}    {white}"
        )
    if found.best is not found.candidates[0]:
        lines.append("Clear water is kept: no other type fits significantly better.")
    errors = series.errors()
    before = f"{np.sqrt(np.mean(errors**2)):.2f} m" if errors.size else "not assessable"
    after = np.sqrt(np.mean(found.residuals**2))
    lines += ["± is from the scatter over frames; errors common to all frames come in addition."]
    lines += ["", f"depth against the sensor, rms: {before} before, {after:.2f} m with *"]
    return "\n".join(lines)


def _describe_lamps(found: LampCalibration, frames: int) -> str:
    """Return the lamps as text, with their standard deviations."""
    low, high = found.range.min(), found.range.max()
    lines = [f"{frames} frames, ground at {low:.2f} to {high:.2f} m", ""]
    for i, lamp in enumerate(found.lamps):
        place = _with_stddev(lamp.position, found.position_stddev[i])
        axis = "  ".join(f"{value:.2f}" for value in lamp.direction)
        lines.append(
            f"  lamp {i + 1}  position (m): {place}   axis: {axis}, "
            f"± {found.direction_stddev[i]:.1f} degrees   beam: {lamp.beam_angle:.0f} degrees "
            f"± {100 * found.beam_stddev:.0f} %")
    water = _with_stddev(found.attenuation, found.attenuation_stddev)
    lines += [
        "", f"  water of the recording, attenuation (1/m), R G B: {water}",
        f"  scatter of the light of a point about the fit: {100 * found.scatter:.1f} %"]
    return "\n".join(lines)


def _with_stddev(values: Iterable[float], stddevs: Iterable[float]) -> str:
    return "  ".join(
        f"{value:.3f} ± {stddev:.3f}" if stddev else f"{value:.3f}"
        for value, stddev in zip(values, stddevs, strict=True))
