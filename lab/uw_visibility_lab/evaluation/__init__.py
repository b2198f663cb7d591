# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Evaluation: the paper's experiments and the adverse ones, reference methods and peers."""
