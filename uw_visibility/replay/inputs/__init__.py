# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What a recording gives: streams of frames, topics, positions and options."""
