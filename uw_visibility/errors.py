# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The one error class that bad input raises, with a sentence for its user."""


class InputError(ValueError):
    """What was given cannot be used: the message names it and says what to do.

    The command prints the message and exits with code 2; the node counts and
    reports a dropped frame, or refuses the parameter.
    """
