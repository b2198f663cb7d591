# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""
Lamps
=====

At night the vehicle's own lamps light the scene. Their light falls off with distance, and near
water scatters most of it back. Given the positions of the lamps, the estimator models both.
"""

# %%
# A night
# -------
# Two lamps beside the camera, over a reef, in water with a mean attenuation of 0.2 1/m.
# ``simulate`` writes the lamps as parameters beside the recording.

import contextlib
import csv
import tempfile
from collections import Counter
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
    "uw_visibility simulate -o night --lamps 2 --attenuation 0.2 0.2 --frames 4 "
    "--width 320 --height 240 --seed 1"
)
print((folder / "night" / "lighting.yaml").read_text())

# %%
# With and without lamp positions
# -------------------------------
# Positions and directions are in the left camera's optical frame: x to the right, y down, z
# forward. :doc:`/lamps` explains the parameters. Without the file most frames are refused, with the
# reason.

terminal("uw_visibility replay night -o untold --jobs 1")
terminal("uw_visibility replay night -o told --params-file night/lighting.yaml --images 1 --jobs 1")


def table(name):
    with (folder / name / "frames.csv").open() as file:
        return list(csv.DictReader(file))


for name in ("untold", "told"):
    print(f"{name}:", dict(Counter(row["status"] for row in table(name))))

# %%
# The water
# ---------
# There is no depth at night: it is estimated from the colour of daylight.

rows = table("told")
frame, alpha, sigma = (
    np.array([float(row[column] or "nan") for row in rows])
    for column in ("frame", "mean_attenuation", "mean_attenuation_stddev")
)
fig, ax = plt.subplots(figsize=(7, 2.6), layout="constrained")
ax.errorbar(frame, alpha, sigma, fmt="o", label="of each frame, ± σ")
ax.axhline(0.2, color="k", ls="--", lw=1, label="truth")
ax.set(xlabel="frame", ylabel="mean attenuation α, 1/m", ylim=(0, 0.4), xticks=frame)
ax.legend()
plt.show()

# %%
# The pictures
# ------------
# As recorded, without water and lamps, and the range.

pictures = sorted((folder / "told" / "images").glob("*.*"))
plt.figure(figsize=(9, 2.6), layout="constrained")
plt.imshow(plt.imread(pictures[0]))
plt.axis("off")
plt.show()
