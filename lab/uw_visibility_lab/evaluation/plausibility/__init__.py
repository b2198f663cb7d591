# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the check of a depth sensor believes of the camera, fitted to rendered transects."""
