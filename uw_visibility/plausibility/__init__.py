# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Whether a depth sensor agrees with the estimate: innovation, NIS and verdict."""
