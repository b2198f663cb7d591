# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Path-traced water: independent test data, to which nothing is fitted.

Mitsuba 3 (Jakob et al. 2022, https://mitsuba-renderer.org) traces light through homogeneous water,
with all orders of scattering, without this package's light model. Rendering needs the extra
`trace` of the lab; reading rendered scenes does not.
"""
