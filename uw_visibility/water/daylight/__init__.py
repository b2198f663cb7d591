# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The estimator in daylight: attenuation, veil and light from pixels and ranges.

Names that mean the same in all modules:

attenuation, clear_water : (3,) float64 ndarray
    β of the water and κ of clear water in the camera's channels, 1/m.
veil, light : (3,) float64 ndarray
    Irradiance B of the water at infinity, and W of white at the scene.
covariance : (6, 6) float64 ndarray
    Of β_R, B_R, β_G, B_G, β_B, B_B.
active : (3,) bool ndarray
    Channels that are fitted.
range_error : float
    Standard deviation of range over its square, 1/m.
"""
