# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""
The paper's figures
===================

``uw_visibility evaluate`` reruns the experiments of Roser, Dunbabin and Geiger (ICRA 2014). It puts
stereo scenes with known disparity under simulated water and compares the estimates with the truth.
"""

# %%
# A small grid
# ------------
# With Middlebury scenes the command is ``uw_visibility evaluate FOLDER_OF_SCENES -o out``, which
# takes minutes; ``--paper`` takes all turbidities and depths of the paper. Without a folder it
# renders three reefs. This page shows two turbidities at one depth.

import contextlib
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from uw_visibility.cli import main

folder = Path(tempfile.mkdtemp())


def terminal(words):
    """Run a command as a terminal would, in the folder of this tutorial."""
    with contextlib.chdir(folder):
        main(words.split()[1:])


terminal("uw_visibility evaluate -o out --attenuation 0 0.2 --depth 2 --noise 0")
out = folder / "out"
print(*sorted(file.name for file in out.iterdir()), sep="\n")


def show(name):
    picture = plt.imread(out / name)
    height, width = picture.shape[:2]
    plt.figure(figsize=(9, 9 * height / width), layout="constrained")
    plt.imshow(picture)
    plt.axis("off")
    plt.show()


# %%
# Envelopes over range (Fig. 3)
# -----------------------------
# Pixels over range, with the dark and the bright envelope and the estimated veil.

show(min(file.name for file in out.glob("fig3_*.png")))

# %%
# Over turbidity (Fig. 6)
# -----------------------
# Attenuation, unmatched and correct disparities: of the pair as recorded, of our method, and of the
# oracle, which knows water and ranges.

show("fig6.png")

# %%
# Pictures (Fig. 9)
# -----------------
# Histogram equalisation and its adaptive form, ours, and the oracle.

show("fig9.png")
