# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Evaluation: the paper's experiments, reference methods and peers."""
