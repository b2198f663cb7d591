# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Random underwater views with ground truth: the prior of the posterior of the water."""
