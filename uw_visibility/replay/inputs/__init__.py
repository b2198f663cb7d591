# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Inputs of a replay: stream of frames, topics, positions and options."""
