# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pipeline of the paper's Fig. 4: from a stereo pair to water, images and disparity."""
