# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Client of the node: collects its outputs and plays bags into it."""
