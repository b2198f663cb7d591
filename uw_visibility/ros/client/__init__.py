# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The node's user: collects its outputs and plays bags into it."""
