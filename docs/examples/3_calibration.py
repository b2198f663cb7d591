# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""
Calibrating a camera against a depth sensor
===========================================

Depth is estimated from the colour of daylight. That needs the camera's white and the water
type. A dive with a depth sensor gives both.
"""

# %%
# A dive
# ------
# Depth must change by a metre or more; here it goes from 2 to 7 m. The camera's white is not
# neutral: its red is 0.8 of its green, its blue 0.7. The estimator does not know that.

import contextlib
import csv
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from uw_visibility.cli import main

folder = Path(tempfile.mkdtemp())


def terminal(words):
    """Run a command as a terminal would, in the folder of this tutorial."""
    with contextlib.chdir(folder):
        main(words.split()[1:])


terminal(
    "uw_visibility simulate -o dive --frames 16 --width 320 --height 240 --depth 2 7 "
    "--attenuation 0.1 0.15 --white-balance 0.8 1 0.7 --seed 4"
)

# %%
# Calibrate
# ---------
# The command tries each water type, with the white that fits best.

terminal("uw_visibility calibrate dive -o camera.yaml --jobs 1")
print((folder / "camera.yaml").read_text())

# %%
# Before and after
# ----------------
# Every command takes the file by ``--params-file``; the node takes it, too. Use it for other dives
# with the same camera in the same water. To be short, this page uses it for the same dive.

terminal("uw_visibility replay dive -o before --jobs 1")
terminal("uw_visibility replay dive -o after --jobs 1 --params-file camera.yaml")


def columns(name, *names):
    with (folder / name / "frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    return [np.array([float(row[n] or "nan") for row in rows]) for n in names]


fig, ax = plt.subplots(figsize=(7, 3.2), layout="constrained")
for name, colour, shift in (("before", "tab:red", -0.15), ("after", "tab:blue", 0.15)):
    frame, depth, sigma, sensor = columns(name, "frame", "depth", "depth_stddev", "sensor_depth")
    label = f"{name} calibration, ± σ"
    ax.errorbar(frame + shift, depth, sigma, fmt=".", color=colour, label=label)
    print(f"{name}: {np.isfinite(depth).sum()} of {len(depth)} frames assessed, "
          f"median |difference| {np.nanmedian(np.abs(depth - sensor)):.2f} m")
ax.plot(frame, sensor, "k--", lw=1, label="depth sensor")
ax.set(xlabel="frame", ylabel="depth, m")
ax.invert_yaxis()
ax.legend(loc="lower left")
plt.show()

# %%
# ``calibrate`` refuses a dive whose depth changes too little, and one with automatic white balance,
# which removes the colour that depth is estimated from.
