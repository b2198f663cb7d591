# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Files of recordings: whole ones through rosbags, damaged ones as far as they can be read."""
