# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Sub-commands of `uw_visibility`: modules with HELP, DESCRIPTION, `add_options` and `run`."""
