# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pixels: files, pair checks, chroma, noise, JPEG, vignetting and flat field."""
