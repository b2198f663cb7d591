# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`python -m uw_visibility_lab.worlds`: make a pool of scenes, or a contact sheet of its views."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

from uw_visibility.errors import InputError, check_range
from uw_visibility.images.files import write_png
from uw_visibility_lab.worlds.draw import EFFECTS, draw
from uw_visibility_lab.worlds.scenes import SIZE, load_scene, make_pool, pool

COLUMNS = 6
"""Views in a row of a contact sheet."""
MOST_JOBS = 256


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m uw_visibility_lab.worlds", description=__doc__)
    parts = parser.add_subparsers(dest="part", required=True)
    making = parts.add_parser("pool", help="make a pool of procedural scenes")
    making.add_argument("--count", type=int, required=True, metavar="N", help="scenes")
    making.add_argument("--seed", type=int, default=0, metavar="S", help="default: 0")
    making.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER")
    making.add_argument(
        "--pictures", type=Path, metavar="FOLDER", help="colour photographs, used as textures")
    making.add_argument(
        "--size", type=int, nargs=2, default=SIZE, metavar=("ROWS", "COLUMNS"),
        help=f"default: {SIZE[0]} {SIZE[1]}")
    making.add_argument(
        "--jobs", type=int, default=1, metavar="N",
        help="processes that make them; the scenes are the same for any number (1)")
    looking = parts.add_parser("sheet", help="draw views of a pool onto a contact sheet")
    looking.add_argument("pool", type=Path, help="folder of scenes")
    looking.add_argument("--count", type=int, default=24, metavar="N", help="views (24)")
    looking.add_argument("--seed", type=int, default=0, metavar="S", help="default: 0")
    looking.add_argument("-o", "--output", type=Path, required=True, metavar="PNG")
    looking.add_argument(
        "--effects", nargs="*", metavar="NAME", help=f"of {', '.join(EFFECTS)} (random)")
    options = parser.parse_args(arguments)
    try:
        if options.part == "pool":
            if options.count < 1:
                raise InputError(f"--count is {options.count}: give 1 or more")
            check_range("--jobs", options.jobs, 1, MOST_JOBS)
            make_pool(
                options.count, options.seed, options.output, options.pictures,
                tuple(options.size), options.jobs)
        else:
            _sheet(options)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _sheet(options: argparse.Namespace) -> None:
    """Write views with their water and effects; linear ones are gamma-encoded for display."""
    scenes = pool(options.pool)
    tiles = []
    for number in range(options.count):
        rng = np.random.default_rng([options.seed, number])
        scene = load_scene(scenes[int(rng.integers(len(scenes)))])
        view = draw(rng, scene, effects=options.effects)
        code = view.image.astype(np.float32) / np.iinfo(view.image.dtype).max
        shown = code if view.curve != "linear" else code ** (1 / 2.2)
        tile = np.ascontiguousarray(np.rint(shown * 255).astype(np.uint8))
        known = np.isfinite(view.ranges)
        median = np.median(view.ranges[known]) if known.any() else np.nan
        lines = [
            f"{median:.1f} m, beta {' '.join(f'{b:.2f}' for b in view.attenuation)}, "
            f"{view.depth:.0f} m deep", ", ".join(view.effects)]
        for k, line in enumerate(lines):
            cv2.putText(
                tile, line[:70], (3, 10 + 10 * k), cv2.FONT_HERSHEY_PLAIN, 0.6, (255, 255, 255), 1)
        tiles.append(tile)
    blank = np.zeros_like(tiles[0])
    tiles += [blank] * (-len(tiles) % COLUMNS)
    rows = [np.hstack(tiles[k:k + COLUMNS]) for k in range(0, len(tiles), COLUMNS)]
    write_png(options.output, np.vstack(rows))


if __name__ == "__main__":
    sys.exit(main())
