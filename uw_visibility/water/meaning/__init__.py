# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What an estimate means: visibility, depth and quantities derived from it."""
