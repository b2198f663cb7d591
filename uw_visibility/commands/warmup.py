# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility warmup`: compile the kernels of the node and the commands in advance."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from uw_visibility.errors import naming

HELP = "compile in advance, for a fast first start"
DESCRIPTION = """\
Compile the pipeline's kernels for 8- and 16-bit images, colour and grey, and keep
them on disk, so that the first start of the node is as fast as any other. A second
call compiles nothing; after an upgrade only changed kernels are compiled.

Kernels are kept beside the package if that folder is writable, otherwise in the user's
cache folder; NUMBA_CACHE_DIR sets another one. If an administrator runs this once for
an installation, all its users have the kernels."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--size", metavar="WxH", type=_size, default=(640, 480),
        help="size of the images to run, px; kernels work for every size (640x480)",
    )
    parser.add_argument(
        "--params-file", metavar="YAML", type=Path,
        help="parameters, in the format of config/uw_visibility.yaml: other methods need "
        "other kernels",
    )


def run(arguments: argparse.Namespace) -> None:
    """Run the sub-command.

    Raises `InputError` if the parameters cannot be used, or the size is too small.
    """
    from uw_visibility.commands.options import read_params_file
    from uw_visibility.config.schema import PipelineConfig
    from uw_visibility.replay.progress import compiling, tell

    config = PipelineConfig.from_parameters(read_params_file(arguments.params_file))
    begin = time.monotonic()
    # Imported late: compiled modules load slowly, and bad input is refused before.
    from uw_visibility import Pipeline, StereoRig
    from uw_visibility.compute.jit import counts
    from uw_visibility.compute.kernel_folder import writable_folder

    width, height = arguments.size
    pipeline = Pipeline(StereoRig(500.0, 0.1, ((width - 1) / 2, (height - 1) / 2)), config)
    tell("preparing the kernels; the first time this takes a minute or two")
    with compiling(), naming(f"cannot warm up with --size {width}x{height}"):
        for dtype in ("uint8", "uint16"):
            for grey in (False, True):
                colour_8_bit = dtype == "uint8" and not grey
                pipeline.warm_up((height, width), dtype, grey=grey, compressed=colour_8_bit)
    duration = time.monotonic() - begin
    folder = writable_folder()
    place = f"kept in {folder}" if folder else "not kept: no folder is writable"
    print(
        f"{counts.compiled} kernels compiled, {counts.loaded} loaded, in {duration:.1f} s; {place}"
    )


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    # Only digits: numpy does not name a negative size in its error.
    if not (width.isdecimal() and height.isdecimal()):
        message = f"{text!r} is not a size: give width x height in px, as in 640x480"
        raise argparse.ArgumentTypeError(message)
    return int(width), int(height)
