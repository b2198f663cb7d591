# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Path-traced water: an independent truth, which judges and teaches nothing.

Light is followed through a homogeneous water by Mitsuba 3 (Jakob et al. 2022,
https://mitsuba-renderer.org), with all orders of scattering: nothing of this package's light
model is in it. It needs the extra `trace` of the lab, but for reading what was rendered.
"""
