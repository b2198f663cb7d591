# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Plausibility of a depth sensor against the estimate: innovation, NIS and verdict."""
