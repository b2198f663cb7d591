# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water: estimation, priors, validation, assessment, and filter over frames."""
