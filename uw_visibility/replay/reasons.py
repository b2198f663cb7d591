# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Counter of reasons, of a bounded size."""

from __future__ import annotations

from collections import Counter

# Reasons may carry numbers of the input, and a recording may be long.
MOST_REASONS = 50
FURTHER = "further reasons"


def count_reason(counter: Counter[str], reason: str) -> None:
    """Count a reason; beyond `MOST_REASONS` different ones, all others are one."""
    if reason not in counter and len(counter) >= MOST_REASONS:
        reason = FURTHER
    counter[reason] += 1
