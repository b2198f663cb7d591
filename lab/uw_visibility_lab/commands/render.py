# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility render`: path-traced scenes under water with ground truth."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from uw_visibility.errors import InputError, check_range
from uw_visibility.replay.progress import say
from uw_visibility_lab.commands.described import REQUIRED, Options, add_described

HELP = "path-traced scenes under water with ground truth"
DESCRIPTION = """\
Draw random sea floors and waters, and render them with a path tracer (Mitsuba 3): with absorption,
and scattering of all orders, without this package's light model. The scenes are test data: nothing
is fitted to them. Each scene has its own folder. Complete folders are kept: give the same command
again to continue after an interruption.

Daylight comes from the sea surface, with the same radiance in all directions; channels are 600, 540
and 460 nm; water is the same everywhere; images have no sensor noise. Install the lab's extra
trace: pip install -e 'lab[trace]'. With an LLVM library of version 16 or later
(DRJIT_LIBLLVM_PATH, or Debian's libllvm19) it is several times faster."""

EPILOG = """\
in each folder:
  left.png                linear, 16 bit
  left.npz                ranges (m along the line of sight, NaN: open water), reflectance, surface
                          (radiance of the surfaces without water in front), and before denoising
                          raw and raw_black (the veil alone: surfaces are black)
  left_srgb.png           for display
  truth.json              written last: absorption, scattering, phase function, attenuation of
                          surfaces' light with its σ, veil (null if too little open water
                          is in view), light, calibration"""

OPTIONS: Options = {
    "-o --output FOLDER": (REQUIRED, "folder of the scenes' folders", Path),
    "--scenes N": (40, "number of scenes"),
    "--seed N": (1, "seed of the first scene; those of the others follow"),
    "--kinds KIND,...": ("boulders,reef", "kinds of scenes, in turn: boulders, reef"),
    "--size WxH": ("320x240", "width and height of an image, px"),
    "--samples N": (128, "paths for each pixel and channel"),
    "--lamps N": (0, "lamps beside the camera, at night, instead of daylight"),
    "--threads N": (2, "number of threads"),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    add_described(parser, OPTIONS)


def run(arguments: argparse.Namespace) -> None:
    check_range("--scenes", arguments.scenes, 1, 100000)
    check_range("--seed", arguments.seed, 0, 1 << 24)
    check_range("--samples", arguments.samples, 1, 1 << 16)
    check_range("--lamps", arguments.lamps, 0, 8)
    check_range("--threads", arguments.threads, 1, 256)
    size = re.fullmatch(r"(\d{1,5})x(\d{1,5})", arguments.size)
    if size is None:
        raise InputError(f"--size is {arguments.size}: give width and height, as in 320x240")
    from uw_visibility_lab.tracer import engine
    from uw_visibility_lab.tracer.render import render_scene
    from uw_visibility_lab.tracer.scene import draw_scene

    kinds = [kind for kind in arguments.kinds.split(",") if kind]
    if not kinds:
        raise InputError("no kind of scene is given: give one at least, as in --kinds reef")
    scenes = []
    for k in range(arguments.scenes):
        seed, kind = arguments.seed + k, kinds[k % len(kinds)]
        scenes.append((f"{seed:05d}_{kind}", draw_scene(seed, kind, arguments.lamps)))
    width, height = int(size[1]), int(size[2])
    check_range("--size", (width, height), 16, 8192, "px")
    # Before rendering, so that a missing package is reported at once.
    engine.mitsuba(arguments.threads)
    for number, (name, description) in enumerate(scenes, 1):
        made = render_scene(
            arguments.output / name, description, (width, height), arguments.samples,
            arguments.threads)
        say(f"{number}/{len(scenes)} {name}: {'rendered' if made else 'complete already'}")
