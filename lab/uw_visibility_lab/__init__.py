# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Laboratory of uw_visibility: simulation, evaluation and demonstration."""
