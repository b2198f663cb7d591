# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility calibrate --lighting`: places, axes and beams of lamps from recorded bags."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from uw_visibility.commands.progress import say
from uw_visibility.commands.recording_options import read_recording_options, reading
from uw_visibility.config.files import write_whole
from uw_visibility.errors import InputError, needing, printable

if TYPE_CHECKING:
    from uw_visibility.water.lamp_calibration import LampCalibration


def run(arguments: argparse.Namespace) -> None:
    """Run the sub-command with ``--lighting``.

    Raises
    ------
    InputError
        If an option or a recording cannot be used, or tells too little.
    SystemExit
        With code 1 where nothing of a recording could be read.
    """
    from uw_visibility.commands.params_file import read_params_file
    from uw_visibility.config.parameter_file import render_values

    output = arguments.output
    picture = None if output is None else output.with_suffix(".png")
    if picture is not None and (picture == output or (picture.exists() and not arguments.force)):
        raise InputError(
            f"the picture would replace {picture}: give -o another name, or --force to replace")
    if picture is not None:
        with needing("report", "the picture of the lamps", ", or leave out -o"):
            from uw_visibility.evaluation.lamps.calibration_figure import draw_calibration
    with reading("calibrate"):
        from uw_visibility.replay.lamp_calibration import calibrate_lighting

        found, frames, damage = calibrate_lighting(
            arguments.bags, read_recording_options(arguments), arguments.lamps)
    names = printable(", ".join(bag.resolve().name for bag in arguments.bags))
    comment = f"Lamps by uw_visibility calibrate --lighting, of {names}: {frames} frames."
    text = render_values(
        read_params_file(arguments.params_file) | found.parameters(), comment)
    print(describe(found, frames), file=sys.stderr if output is None else sys.stdout)
    for note in damage:
        say(f"uw_visibility: warning: {note}", error=True)
    if picture is None:
        print(text, end="")
        return
    draw_calibration(picture, found)
    write_whole(output, text)
    say(f"written to {output} and {picture}")


def describe(found: LampCalibration, frames: int) -> str:
    """Return the lamps as text, with their standard deviations."""
    low, high = found.range.min(), found.range.max()
    lines = [f"{frames} frames, ground at {low:.2f} to {high:.2f} m", ""]
    for i, lamp in enumerate(found.lamps):
        place = "  ".join(
            f"{value:.3f} ± {stddev:.3f}"
            for value, stddev in zip(lamp.position, found.position_stddev[i], strict=True))
        axis = "  ".join(f"{value:.2f}" for value in lamp.direction)
        lines.append(
            f"  lamp {i + 1}  place (m): {place}   axis: {axis}, ± {found.direction_stddev[i]:.1f} "
            f"degrees   beam: {lamp.beam_angle:.0f} degrees ± {100 * found.beam_stddev:.0f} %")
    water = "  ".join(
        f"{value:.3f} ± {stddev:.3f}"
        for value, stddev in zip(found.attenuation, found.attenuation_stddev, strict=True))
    lines += [
        "", f"  water of the recording, attenuation (1/m), R G B: {water}",
        f"  light of a point about the fit: {100 * found.scatter:.1f} %"]
    return "\n".join(lines)
