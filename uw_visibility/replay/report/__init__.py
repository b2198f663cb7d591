# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Report of a recording, in HTML and figures."""
