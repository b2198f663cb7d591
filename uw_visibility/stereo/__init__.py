# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stereo: calibration, rig, contrast for matching, matchers, and gap filling."""
