# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstration: a simulated transect through the real node, compared with the truth."""
