# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Training of the posterior of water, and tests of estimators against the truth."""
