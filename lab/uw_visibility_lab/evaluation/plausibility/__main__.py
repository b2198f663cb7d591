# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit what the check of a depth sensor believes of the camera.

Renders twelve transects of 240 frames, which takes twenty minutes of computing, fits
`uw_visibility.plausibility.model.CAMERA` to nine of them, and prints it with its likelihood over
these and over the three others, which have another way, beside that of the package's constants.
"""

from __future__ import annotations

import argparse

from uw_visibility.compute.threads import Workers
from uw_visibility.plausibility.model import CAMERA, Camera
from uw_visibility_lab.evaluation.plausibility.fit import fit, log_likelihood
from uw_visibility_lab.evaluation.plausibility.series import FITTED, LEFT_OUT, render_series


def main() -> None:
    """Render, fit, and print."""
    parser = argparse.ArgumentParser(
        prog="python -m uw_visibility_lab.evaluation.plausibility", description=__doc__)
    parser.add_argument(
        "--threads", type=int, default=0, help="threads that render; 0 for one per processor")
    workers = Workers(parser.parse_args().threads)
    fitted, left_out = (
        [render_series(transect, workers) for transect in transects.values()]
        for transects in (FITTED, LEFT_OUT))
    camera = rounded(fit(fitted))
    print("fitted to " + "; ".join(FITTED))
    print(f"CAMERA = {camera}")
    for name, each in {"fitted": camera, "the package's": CAMERA}.items():
        print(f"log likelihood, {name}: {log_likelihood(each, fitted):.1f}, "
              f"left out {log_likelihood(each, left_out):.1f}")


def rounded(camera: Camera) -> Camera:
    """Return constants with two digits: more would say more than the series do."""
    return Camera(*(float(f"{value:.2g}") for value in camera))


if __name__ == "__main__":
    main()
