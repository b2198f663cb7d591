# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Random underwater views with their truth: the prior of a posterior of the water."""
