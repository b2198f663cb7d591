# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit what the check of a depth sensor believes of the camera, and judge it on other transects.

Renders twelve transects of 240 frames into FOLDER (what is there already is taken from there), fits
`uw_visibility.plausibility.model.CAMERA` to nine of them, prints it, and prints what the check says
over the three others, which have another way, and over the nine: with the constants fitted, and
with those of the package where they differ.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError
from uw_visibility.plausibility.model import CAMERA, Camera
from uw_visibility_lab.evaluation.plausibility.fit import fit, log_likelihood
from uw_visibility_lab.evaluation.plausibility.judge import judge, table
from uw_visibility_lab.evaluation.plausibility.series import FITTED, JUDGED, load_series


def main() -> None:
    """Load or render, fit, judge, and print."""
    parser = argparse.ArgumentParser(
        prog="python -m uw_visibility_lab.evaluation.plausibility", description=__doc__)
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="where the series are kept")
    parser.add_argument(
        "--threads", type=int, default=0, help="threads that render; 0 for one per processor")
    arguments = parser.parse_args()
    workers = Workers(arguments.threads)
    try:
        fitted = load_series(FITTED, arguments.folder, workers)
        judged = load_series(JUDGED, arguments.folder, workers)
    except InputError as error:
        sys.exit(f"uw_visibility: {error}")
    camera = rounded(fit(list(fitted.values())))
    print("fitted to " + "; ".join(FITTED))
    print(f"log likelihood {log_likelihood(camera, fitted.values()):.1f}, of the others "
          f"{log_likelihood(camera, judged.values()):.1f}")
    print(f"CAMERA = {camera}")
    cameras = {"fitted": camera} | ({} if camera == CAMERA else {"the package's": CAMERA})
    for name, each in cameras.items():
        for kind, series in (("judged", judged), ("fitted to", fitted)):
            print(table(f"{kind}, {name}", {way: judge(s, each) for way, s in series.items()}))


def rounded(camera: Camera) -> Camera:
    """Return constants with two digits: more would say more than the series do."""
    return Camera(*(float(f"{value:.2g}") for value in camera))


if __name__ == "__main__":
    main()
