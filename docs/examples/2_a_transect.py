# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""
A transect and its report
=========================

This tutorial turns a recording into a table and a report of the water over time.
"""

# %%
# A recording
# -----------
# Any bag with a stereo pair will do: ROS 2 (mcap, sqlite3) or ROS 1. This one is rendered: the
# water becomes murkier and the camera goes deeper. Commands are those of a terminal.

import contextlib
import csv
import json
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from uw_visibility.cli import main
from uw_visibility.replay.bags.reader import BagReader

folder = Path(tempfile.mkdtemp())


def terminal(words):
    """Run a command as a terminal would, in the folder of this tutorial."""
    with contextlib.chdir(folder):
        main(words.split()[1:])


terminal("uw_visibility simulate -o dive --frames 12 --width 320 --height 240 --seed 1")

# %%
# Replay
# ------
# ``--list`` shows which topics there are and which would be used.

terminal("uw_visibility replay dive --list")
terminal("uw_visibility replay dive -o out --images 4 --jobs 1")
print(*sorted(file.name for file in (folder / "out").iterdir()), sep="\n")

# %%
# The table
# ---------
# The table has one row for each frame. An empty cell is a value that could not be assessed; the
# status beside it says why. ``filtered_…`` are the same quantities filtered over frames.

with (folder / "out" / "frames.csv").open() as file:
    rows = list(csv.DictReader(file))


def column(name):
    return np.array([float(row[name] or "nan") for row in rows])


print({status: sum(row["status"] == status for row in rows) for status in
       {row["status"] for row in rows}})

# %%
# Beside the truth
# ----------------
# A simulated recording holds the truth under ``/ground_truth``.

with BagReader(folder / "dive") as bag:
    truth = [
        bag.deserialize(recorded).data
        for recorded in bag.messages(["/ground_truth/mean_attenuation"])
    ]

frame = column("frame")
fig, ax = plt.subplots(figsize=(7, 3), layout="constrained")
ax.errorbar(frame, column("mean_attenuation"), column("mean_attenuation_stddev"), fmt=".",
            color="0.6", label="of each frame, ± σ")
ax.plot(frame, column("filtered_mean_attenuation"), label="filtered")
ax.plot(np.arange(len(truth)), truth, "k--", lw=1, label="truth")
ax.set(xlabel="frame", ylabel="mean attenuation α, 1/m")
ax.legend()
plt.show()

# %%
# The report
# ----------
# ``report.html`` opens in any browser, without a network. It has time series, pictures, and a list
# of what could not be assessed, with the frames and the reasons. ``replay.json`` has the version,
# the parameters and the input.

pictures = sorted((folder / "out" / "images").glob("*.*"))
plt.figure(figsize=(9, 2.6), layout="constrained")
plt.imshow(plt.imread(pictures[0]))
plt.axis("off")
plt.show()

about = json.loads((folder / "out" / "replay.json").read_text())
print({name: about[name] for name in ("version", "frames") if name in about})

# %%
# In Python
# ---------
# The same frame by frame, without files in between:

import uw_visibility.replay

for replayed in uw_visibility.replay.read(folder / "dive", every=4):
    seen = replayed.result.visibility
    print(f"frame {replayed.number}: {seen.distance:.1f} ± {seen.distance_stddev:.1f} m")
