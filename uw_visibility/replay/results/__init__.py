# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Results of a replay: table, mcap, summary and provenance."""
