# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""
Adding a matcher
================

The stereo matcher is a class with a few calls and an entry in a dictionary. Here OpenCV's
semi-global matcher takes the place of the dense search.
"""

# %%
# Methods of a matcher
# --------------------
# :class:`~uw_visibility.stereo.elas.Matcher`, the matcher of ELAS, has methods that take the pair
# as recorded, take the pair with restored contrast, match sparsely, interpolate, and match densely.
# A subclass replaces some of them.
#
# The restored views arrive as :class:`~uw_visibility.stereo.contrast.ContrastNormalizer`: a grey
# image and, for each pixel, the gain that restores its contrast. A matcher of gradients takes
# both; one of grey values takes their product.

import cv2
import matplotlib.pyplot as plt
import numpy as np

from uw_visibility import Pipeline, PipelineConfig
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.transect import Transect
from uw_visibility.stereo.elas import DenseMatch, Matcher
from uw_visibility.stereo.matchers import MATCHERS


class SemiGlobalMatcher(Matcher):
    """Semi-global matching (Hirschmüller 2008) of OpenCV, on the support points of ELAS."""

    def __init__(self, shape, disparities, config, workers):
        super().__init__(shape, disparities, config, workers)
        low, high = disparities
        count = 16 * -(-(high - low + 1) // 16)
        self._restored = [np.zeros(shape, np.uint8) for _ in range(2)]
        self._matcher = cv2.StereoSGBM_create(
            minDisparity=low, numDisparities=count, blockSize=5, P1=200, P2=800,
            disp12MaxDiff=1, uniquenessRatio=5, speckleWindowSize=100, speckleRange=1,
        )

    def describe_view(self, side, image):
        """Keep the restored view: its fine contrast, amplified by the gain."""
        super().describe_view(side, image)
        grey = image.grey.astype(np.float32)
        detail = (grey - cv2.GaussianBlur(grey, (0, 0), 8)) * image.gain
        self._restored[side] = np.clip(128 + detail, 0, 255).astype(np.uint8)

    def dense_disparity(self, support, *, confidence=True, least_for_colour=0.0):
        """Match every pixel of the restored pair; all matches have the same confidence."""
        found = self._matcher.compute(*self._restored).astype(np.float32) / 16
        found[found < self._matcher.getMinDisparity()] = np.nan
        rated = np.isfinite(found).astype(np.float32) if confidence else None
        return DenseMatch(found, rated, found)


# %%
# In the pipeline
# ---------------
# Add the class to the dictionary. In a fork it would be in a file beside ``stereo/matchers.py``.

camera = StereoCamera(width=320, height=240, focal_length=300.0, baseline=0.12)
plan = Transect(frames=1, depth=(3.0, 3.0), attenuation=(0.2, 0.2), seed=3, camera=camera)
truth = next(plan.render()).frame
config = PipelineConfig.from_parameters({"stereo.max_disparity": 63})

maps = {}
for name, matcher in (("semi-global", SemiGlobalMatcher), ("ELAS", Matcher)):
    MATCHERS["elas"] = matcher
    result = Pipeline(camera.rig, config).process(truth.left, truth.right)
    maps[name] = result.disparity
    scene = np.isfinite(truth.disparity_left)
    with np.errstate(invalid="ignore"):
        correct = np.abs(result.disparity - truth.disparity_left)[scene] <= 1
    seen = result.visibility
    print(f"{name}: {correct.mean():.1%} of the scene within 1 px, "
          f"α = {seen.mean_attenuation:.3f} ± {seen.mean_attenuation_stddev:.3f} 1/m "
          f"(truth {truth.mean_attenuation:.3f})")

# %%

fig, axes = plt.subplots(1, 3, figsize=(9, 2.4), layout="constrained")
for ax, (name, disparity) in zip(
    axes, [("truth", truth.disparity_left), *maps.items()], strict=True
):
    shown = ax.imshow(disparity, vmin=0, vmax=25, cmap="viridis")
    ax.set_title(name)
    ax.axis("off")
fig.colorbar(shown, ax=axes, label="disparity, px")
plt.show()

# %%
# In open water the semi-global matcher finds false matches: amplified noise looks like texture. The
# ELAS matcher does not match what noise explains.
#
# Without the pipeline
# --------------------
# To estimate only the water, pass disparities to :func:`uw_visibility.estimate_water`:
# see :doc:`1_one_pair`.
