# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics: rates, and the reasons why there is no output."""
