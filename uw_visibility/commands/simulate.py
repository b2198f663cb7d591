# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility simulate`: an underwater stereo transect as a bag, with its truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

DESCRIPTION = """\
Render a stereo camera that swims over a reef while depth and turbidity change, and
record it as a rosbag2 (mcap): images, calibration and a depth sensor as a vehicle
has them, and the truth about water, depth and disparity under /ground_truth.
The same options give the same recording."""


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Add the sub-command `simulate`."""
    parser = subparsers.add_parser(
        "simulate",
        help="an underwater stereo transect with its ground truth",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "-o", "--output", metavar="BAG", type=Path, required=True, help="folder of the new bag"
    )
    parser.add_argument("--force", action="store_true", help="replace a bag of that name")
    add = parser.add_argument
    add("--frames", metavar="N", type=int, default=60, help="stereo frames (%(default)s)")
    add("--rate", metavar="HZ", type=float, default=2.0, help="frames per second (%(default)s)")
    add("--width", metavar="PX", type=int, default=640, help="width of an image (%(default)s)")
    add("--height", metavar="PX", type=int, default=480, help="height of an image (%(default)s)")
    add(
        "--focal-length", metavar="PX", type=float,
        help="focal length (default: 15/16 of the width)",
    )
    add(
        "--baseline", metavar="M", type=float, default=0.12,
        help="distance of the cameras (%(default)s)",
    )
    add("--seed", metavar="N", type=int, default=0, help="seed of reef and noise (%(default)s)")
    add(
        "--depth", metavar=("A", "B"), type=float, nargs=2, default=(2.0, 6.0),
        help="depth at start and end, m (2 6)",
    )
    add(
        "--attenuation", metavar=("A", "B"), type=float, nargs=2, default=(0.05, 0.3),
        help="mean attenuation at start and end, 1/m (0.05 0.3)",
    )
    add("--speed", metavar="M/S", type=float, default=0.4, help="over ground (%(default)s)")
    add(
        "--exposure", metavar="GAIN", type=float,
        help="fixed exposure, where white at the surface comes to GAIN (default: automatic)",
    )
    add(
        "--depth-stddev", metavar="M", type=float, default=0.05,
        help="noise of the depth sensor (%(default)s)",
    )
    add("--noiseless", action="store_true", help="quantisation only, no noise of the sensor")
    add(
        "--marine-snow", metavar="SHARE", type=float, default=0.0,
        help="share of the pixels that particles cover, 0 .. 0.5 (%(default)s)",
    )
    add(
        "--caustics", metavar="SHARE", type=float, default=0.0,
        help="change of light by waves, 0 .. 1 (%(default)s)",
    )
    add("--threads", metavar="N", type=int, default=0, help="threads; 0 takes one per processor")
    parser.set_defaults(func=run)


def run(arguments: argparse.Namespace) -> None:
    """Run the sub-command.

    Raises
    ------
    InputError
        If an option cannot be used or the bag exists already.
    """
    from uw_visibility.commands.progress import progress_bar
    from uw_visibility.compute.threads import Workers
    from uw_visibility.simulation.bag import write_transect
    from uw_visibility.simulation.camera import NOISELESS, Sensor, StereoCamera
    from uw_visibility.simulation.frame import Effects
    from uw_visibility.simulation.transect import Transect

    focal_length = arguments.focal_length
    if focal_length is None:
        focal_length = arguments.width * 15 / 16
    transect = Transect(
        frames=arguments.frames,
        rate=arguments.rate,
        depth=tuple(arguments.depth),
        attenuation=tuple(arguments.attenuation),
        speed=arguments.speed,
        seed=arguments.seed,
        exposure=arguments.exposure,
        camera=StereoCamera(arguments.width, arguments.height, focal_length, arguments.baseline),
        sensor=NOISELESS if arguments.noiseless else Sensor(),
        effects=Effects(arguments.marine_snow, arguments.caustics),
        workers=Workers(arguments.threads),
    )
    write_transect(
        arguments.output,
        transect,
        depth_stddev=arguments.depth_stddev,
        overwrite=arguments.force,
        progress=lambda frames: progress_bar(frames, "simulate", transect.frames),
    )
    print(f"{arguments.output}: {transect.frames} stereo frames at {transect.rate:g} Hz")
