# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""
The paper's figures
===================

``uw_visibility evaluate`` reruns the experiments of Roser, Dunbabin and Geiger (ICRA 2014): stereo
scenes with known disparity are put under water, and what comes out is held against the truth.
"""

# %%
# A small grid
# ------------
# With Middlebury scenes it is ``uw_visibility evaluate FOLDER_OF_SCENES -o out``, at all
# turbidities and depths of the paper, and takes minutes. Without a folder three rendered reefs
# stand for them; here two turbidities at one depth.

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


terminal("uw_visibility evaluate -o out --attenuation 0 0.2 --depth 2 --noise 0 --frames 0")
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
# Pixels over range, the dark and the bright envelope, and the fitted veil.

show(min(file.name for file in out.glob("fig3_*.png")))

# %%
# Over turbidity (Fig. 6)
# -----------------------
# Attenuation, unmatched and correct disparities: of the pair as it is, of ours, of the oracle,
# which knows water and ranges.

show("fig6.png")

# %%
# Pictures (Fig. 9)
# -----------------
# Histogram equalisation and its adaptive form, ours, and the oracle.

show("fig9.png")
