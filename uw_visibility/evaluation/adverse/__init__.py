# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The adverse study: what estimates say where water and camera are not the model's."""
