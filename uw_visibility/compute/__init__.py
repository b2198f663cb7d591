# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels, threads, processes and numerics."""
