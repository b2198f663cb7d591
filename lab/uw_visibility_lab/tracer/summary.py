# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Attenuation of surfaces' light over beam attenuation, in a folder of traced scenes.

    python -m uw_visibility_lab.tracer.summary FOLDER [--refit]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility.replay.progress import say
from uw_visibility_lab.tracer.files import TRUTH, Traced, load
from uw_visibility_lab.tracer.series import refit

MEASURES = ("attenuation", "attenuation_contrast", "veil_growth")
"""Fields of `Traced` that are compared with beam attenuation."""


def ratios(scenes: Sequence[Traced], measure: str) -> tuple[Array, Array]:
    """Ratio of a measure to beam attenuation, and what it comes to as a share of scattering.

    scenes: read from folders.
    measure: one of `MEASURES`.
    Returns `ratio`, (N, 3), measure / c; `kept`, (N, 3), (c - measure) / b: the share of what is
    scattered that is not lost.
    """
    values = np.array([getattr(scene, measure) for scene in scenes])
    beam = np.array([scene.beam_attenuation for scene in scenes])
    scattering = np.array([scene.scattering for scene in scenes])
    return values / beam, (beam - values) / scattering


def complete(folder: Path) -> list[Path]:
    """Return the complete scenes of a folder; an `InputError` if there is none."""
    found = sorted(path.parent for path in folder.glob(f"*/{TRUTH}"))
    if not found:
        raise InputError(f"{folder} has no traced scene: make some with uw_visibility render")
    return found


def table(scenes: Sequence[Traced]) -> list[str]:
    """Return a table: by phase function and measure median, 16 and 84 % of all channels."""
    lines = ["| Phase function | Scenes | Measure | Over c | Share of scattering kept |",
             "| --- | --- | --- | --- | --- |"]
    names = [scene.truth["description"]["water"]["phase"] for scene in scenes]
    for phase in sorted(set(names)):
        chosen = [scene for scene, name in zip(scenes, names, strict=True) if name == phase]
        for measure in MEASURES:
            cells = []
            for values in ratios(chosen, measure):
                low, middle, high = np.nanquantile(values, [0.16, 0.5, 0.84])
                cells.append(f"{middle:.2f} ({low:.2f} to {high:.2f})")
            lines.append(f"| {phase} | {len(chosen)} | {measure} | {cells[0]} | {cells[1]} |")
    return lines


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--refit", action="store_true", help="fit the truth again from the kept images")
    arguments = parser.parse_args()
    found = complete(arguments.folder)
    if arguments.refit:
        for folder in found:
            refit(folder)
    for line in table([load(folder) for folder in found]):
        say(line)


if __name__ == "__main__":
    main()
