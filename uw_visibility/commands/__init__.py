# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Sub-commands of `uw_visibility`: a module each, with HELP, DESCRIPTION, perhaps EPILOG,
`add_options(parser)` and `run(arguments)`."""
