# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""State of a part of the node, as /diagnostics shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE,
)


@dataclass(frozen=True)
class Finding:
    """State of a part of the node: level, one sentence, and numbers."""

    level: bytes
    message: str
    values: Mapping[str, Any] = field(default_factory=dict)
