# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters: frozen dataclasses with unit, bounds and description; YAML."""
