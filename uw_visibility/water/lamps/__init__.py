# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water in the light of lamps: their model, estimation, survey and calibration.

D is the direct light of the lamps at a place, S the light that the water in front scatters, both
for lamps of relative power 1; see `uw_visibility.optics.lamps`.
"""
