# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Command line by `python -m uw_visibility`."""

from uw_visibility.cli import run

if __name__ == "__main__":
    run()
