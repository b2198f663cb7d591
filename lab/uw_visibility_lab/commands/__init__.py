# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Sub-commands that the lab adds to `uw_visibility`, one module each."""
