# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit what the check of a depth sensor believes of the camera.

Renders twelve transects of 240 frames into FOLDER (what is there already is taken from there), fits
`uw_visibility.plausibility.model.CAMERA` to nine of them, and prints it with its likelihood over
these and over the three others, which have another way, beside that of the package's constants.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError
from uw_visibility.plausibility.model import CAMERA, Camera
from uw_visibility_lab.evaluation.plausibility.fit import fit, log_likelihood
from uw_visibility_lab.evaluation.plausibility.series import FITTED, LEFT_OUT, load_series


def main() -> None:
    """Load or render, fit, and print."""
    parser = argparse.ArgumentParser(
        prog="python -m uw_visibility_lab.evaluation.plausibility", description=__doc__)
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="where the series are kept")
    parser.add_argument(
        "--threads", type=int, default=0, help="threads that render; 0 for one per processor")
    arguments = parser.parse_args()
    workers = Workers(arguments.threads)
    try:
        fitted = load_series(FITTED, arguments.folder, workers)
        left_out = load_series(LEFT_OUT, arguments.folder, workers)
    except InputError as error:
        sys.exit(f"uw_visibility: {error}")
    camera = rounded(fit(list(fitted.values())))
    print("fitted to " + "; ".join(FITTED))
    print(f"CAMERA = {camera}")
    for name, each in {"fitted": camera, "the package's": CAMERA}.items():
        print(f"log likelihood, {name}: {log_likelihood(each, fitted.values()):.1f}, "
              f"left out {log_likelihood(each, left_out.values()):.1f}")


def rounded(camera: Camera) -> Camera:
    """Return constants with two digits: more would say more than the series do."""
    return Camera(*(float(f"{value:.2g}") for value in camera))


if __name__ == "__main__":
    main()
