# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water: estimation by daylight and under lamps, series of frames, meaning of the estimates."""
