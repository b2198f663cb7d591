# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""
One pair
========

This tutorial takes one stereo pair and shows what is estimated of the water, with its uncertainty,
and the picture without the water.
"""

# %%
# A pair
# ------
# Read your own pair by ``uw_visibility.images.files.read_image("left.png")``. This page renders a
# reef in water with a mean attenuation of 0.2 1/m at a depth of 4 m, so that the truth is known.
# Images are ``(H, W, 3)`` RGB, rectified.

import matplotlib.pyplot as plt
import numpy as np

from uw_visibility import Pipeline, PipelineConfig
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.transect import Transect

camera = StereoCamera(width=320, height=240, focal_length=300.0, baseline=0.12)
plan = Transect(frames=1, depth=(4.0, 4.0), attenuation=(0.2, 0.2), seed=3, camera=camera)
truth = next(plan.render()).frame
left, right = truth.left, truth.right

# %%
# The pipeline
# ------------
# Make one pipeline for a rig and its parameters. It processes any number of pairs.

config = PipelineConfig.from_parameters({"stereo.max_disparity": 48})
pipeline = Pipeline(camera.rig, config)
result = pipeline.process(left, right)

# %%
# The water
# ---------
# Every number has a standard deviation. A number that cannot be estimated is NaN, and its status
# says why. Look at the status first.

print("status:", result.status)
for name, beta, sigma, true in zip(
    "RGB", result.water.attenuation, result.water.attenuation_stddev, truth.attenuation, strict=True
):
    print(f"β {name}: {beta:.3f} ± {sigma:.3f} 1/m   (truth {true:.3f})")

seen = result.visibility
print(f"mean attenuation: {seen.mean_attenuation:.3f} ± {seen.mean_attenuation_stddev:.3f} 1/m"
      f"   (truth {truth.mean_attenuation:.3f})")
print(f"visibility: {seen.distance:.1f} ± {seen.distance_stddev:.1f} m")
print(f"depth: {seen.depth:.1f} ± {seen.depth_stddev:.1f} m   (truth {truth.depth:.1f})")

# %%
# How attenuation shows
# ---------------------
# The darkest pixels at each range show little but veil: daylight that the water scatters into the
# camera. The veil rises with range towards the colour of open water, at the rate β. Networks weigh
# this cue and others (:doc:`/theory/posterior`).

envelope = result.water.envelope
distance = np.linspace(0.0, envelope.range[-1], 100)
fig, axes = plt.subplots(1, 3, figsize=(9, 3), sharey=True, layout="constrained")
for channel, (ax, name) in enumerate(zip(axes, ("red", "green", "blue"), strict=True)):
    beta, veil = result.water.attenuation[channel], result.water.veil[channel]
    ax.plot(envelope.range, envelope.bright[channel], ".", color="0.6", label="bright envelope")
    ax.plot(envelope.range, envelope.dark[channel], ".", color=name, label="dark envelope")
    ax.plot(distance, veil * (1 - np.exp(-beta * distance)), "k-", lw=1, label="veil, estimated")
    ax.set(title=f"{name}, β = {beta:.2f} 1/m", xlabel="range, m")
axes[0].set_ylabel("irradiance")
axes[2].legend()
plt.show()

# %%
# Pictures and ranges
# -------------------
# ``result.range`` is the measured range, NaN where nothing matched. ``result.stereo.filled_range``
# has its holes filled; it is used for colour only.

fig, axes = plt.subplots(1, 3, figsize=(9, 2.6), layout="constrained")
for ax, picture, title in zip(
    axes[:2], (left, result.left_enhanced), ("as recorded", "without the water"), strict=True
):
    ax.imshow(picture)
    ax.set_title(title)
shown = axes[2].imshow(result.range, cmap="viridis", vmax=10)
axes[2].set_title("range, m")
fig.colorbar(shown, ax=axes[2])
for ax in axes:
    ax.axis("off")
plt.show()

error = np.abs(result.disparity - truth.disparity_left)
known = np.isfinite(error)
correct = np.mean(error[known] <= 1)
print(f"matched {known.mean():.0%} of the picture, {correct:.1%} of that within 1 px")

# %%
# Disparities of your own
# -----------------------
# With another matcher, or with ranges from another sensor, estimate only the water.

from uw_visibility import estimate_water

found = estimate_water(left, truth.disparity_left, camera.rig, disparity_stddev=0.0)
print(f"mean attenuation with exact disparities: {found.visibility.mean_attenuation:.3f}"
      f" ± {found.visibility.mean_attenuation_stddev:.3f} 1/m")
print("not assessed:", found.reasons or "nothing")
