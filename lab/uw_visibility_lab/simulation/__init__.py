# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Rendered underwater stereo scenes with exact ground truth, and bags made of them."""
