# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility demo`: simulate, run the node, play the bag into it, report."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from uw_visibility.errors import needing, refusing
from uw_visibility_lab.commands.described import add_described

HELP = "simulate, run the node, play the bag into it, report"
DESCRIPTION = """\
Simulate a short transect, start the node in a process of its own, play the recording
into it over DDS at the recorded rate, and compare its results with the truth."""

EPILOG = """\
written to DIR:
  frame_NNN.png   raw and enhanced image, range, estimates and truth
  series.png      mean attenuation, visibility distance and depth, with the truth
  frames.csv      a row for each frame
  transect/       the recording
  node.log        what the node printed

The node runs with its default parameters, in its own ROS domain, which is limited to
this machine. Images are stamped when they are sent; latency is the time from then to
the arrival of the last message of their result."""


def add_options(parser: argparse.ArgumentParser) -> None:
    add_described(parser, {
        "-o --output DIR": (Path("demo"), "folder for the results", Path),
        "--force": (False, "replace the results of an earlier demonstration"),
        "--frames N": (20, "stereo frames"), "--rate HZ": (2.0, "frames per second"),
        "--seed N": (0, "seed of the simulation"),
    })


def run(arguments: argparse.Namespace) -> None:
    """Exit with code 1 if the node ends too early."""
    from uw_visibility_lab.simulation.transect import Transect

    transect = Transect(frames=arguments.frames, rate=arguments.rate, seed=arguments.seed)
    with needing("ros,report", "the demo"):
        # These imports need ROS, recordings and figures.
        from uw_visibility_lab.demonstration.node_process import NodeDied
        from uw_visibility_lab.demonstration.run import demonstrate
    with refusing(f"cannot make folder {arguments.output}"):
        arguments.output.mkdir(parents=True, exist_ok=True)
    try:
        summary = demonstrate(arguments.output, transect, force=arguments.force)
    except NodeDied as error:
        print(f"uw_visibility: {error}", file=sys.stderr)
        raise SystemExit(1) from error
    width = max(map(len, summary))
    for name, value in summary.items():
        print(f"{name:{width}s}  {value}")
    print(f"pictures and tables: {arguments.output}")
