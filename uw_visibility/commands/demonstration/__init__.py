# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The demonstration: a simulated transect through the real node, held against the truth."""
