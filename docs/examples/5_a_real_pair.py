# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""
A pair of your own
==================

What to check on a pair of your own before you trust its numbers.
"""

# %%
# Pictures and calibration
# ------------------------
# Put the paths of your own rectified pair here, and of its calibration: a JSON file with ``P1`` and
# ``P2`` as ``cv2.stereoRectify`` gives them. The project has no underwater pair under a free
# licence. A site that is built beside the project's test data shows one of those pairs, a
# calibration board in turbid, shallow water by day. Otherwise this page
# shows a rendered pair. It prints which.

import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from uw_visibility import Pipeline, PipelineConfig, StereoRig
from uw_visibility.images.files import read_image
from uw_visibility.images.overview import overview
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.transect import Transect

data = Path("../../../shared/data/underwater/bermuda")
paths = data / "left_10.png", data / "right_10.png"
calibration = data / "calibration.json"

if calibration.is_file():
    kind, transfer = "real", "srgb"
    left, right = (read_image(path) for path in paths)
    numbers = json.loads(calibration.read_text(encoding="utf-8"))
    rig = StereoRig.from_projection(numbers["P1"], numbers["P2"])
else:
    kind, transfer = "rendered", "linear"
    camera = StereoCamera(width=320, height=240, focal_length=300.0, baseline=0.12)
    plan = Transect(frames=1, depth=(2.0, 2.0), attenuation=(0.3, 0.3), seed=5, camera=camera)
    frame = next(plan.render()).frame
    left, right, rig = frame.left, frame.right, camera.rig
print(f"a {kind} pair of {left.shape[1]}x{left.shape[0]} pixels")

# %%
# The transfer
# ------------
# Images that are encoded for screens are ``srgb``; raw sensor data are ``linear``, the
# default. With the wrong one every number is wrong.

config = PipelineConfig.from_parameters({"camera.transfer": transfer})
result = Pipeline(rig, config).process(left, right, match_original=True)

# %%
# Before and after
# ----------------
# The same picture as ``overview.png`` of ``uw_visibility enhance``: the left image, the same
# without the water, the range with its scale. Near is light, far is dark, and what was not matched
# is black.

shown = overview(
    left, result.left_enhanced, result.range, f"transfer {transfer}", rig.range_error())
figure = plt.figure(figsize=(9.0, 9.0 * shown.shape[0] / shown.shape[1]))
axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
axes.imshow(shown)
axes.axis("off")
plt.show()

# %%
# Check the range first: everything else depends on it. Flat things must be flat, and steps must lie
# at the edges of objects. Patches that follow no object mean that rows do not correspond, or that
# the calibration is of another focus. The right camera does not see the black strip at the left.

print(f"matched: {np.isfinite(result.disparity).mean():.0%} of the pixels")
nearest, farthest = np.nanpercentile(result.range, [1.0, 99.0])
print(f"ranges: {nearest:.2f} to {farthest:.2f} m")

# %%
# The water
# ---------
# Every quantity has its own status. A scene with few ranges gives attenuation with a large σ.
# A visibility distance that is not known within a factor of two is refused, with the reason.

print("water:", result.status)
for name, beta, sigma in zip(
    "RGB", result.water.attenuation, result.water.attenuation_stddev, strict=True
):
    print(f"β {name}: {beta:.2f} ± {sigma:.2f} 1/m")
seen = result.visibility
print(f"visibility: {seen.distance:.1f} ± {seen.distance_stddev:.1f} m ({seen.status})")
print(f"depth: {seen.depth:.1f} ± {seen.depth_stddev:.1f} m ({seen.depth_status})")

# %%
# :doc:`/reference/statuses` says what each status means and what to do. :doc:`/start/rig` says what
# a good rig needs.
