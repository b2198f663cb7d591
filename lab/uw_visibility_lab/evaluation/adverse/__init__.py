# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Adverse study: estimates where water and camera depart from the model."""
