# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Spectra and coefficients, as CSV tables that name their source and licence."""
