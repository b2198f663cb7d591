# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Enhancement: dense range by matting, and restoration of the scene's radiance."""
