# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stereo: rig, ELAS matcher, gap filling, and priors from the water."""
