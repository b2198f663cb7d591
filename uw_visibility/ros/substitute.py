# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The built-in matcher and restorer in the place of a network that fails again and again."""

from __future__ import annotations

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.network import NetworkError

MOST_FAILURES = 3
"""So many frames in a row that a network loses make the built-in parts take over."""


class Substitute:
    """Counts the frames that a network lost; called by the pipeline's thread.

    Recordings are replayed without: what a frame gives may not depend on those before it.

    Attributes
    ----------
    reason : str
        Why the built-in parts stand in; "" where they do not.
    """

    def __init__(self) -> None:
        self.reason = ""
        self._failures = 0
        self._wanted: PipelineConfig | None = None

    def config(self, wanted: PipelineConfig) -> PipelineConfig:
        """Return the configuration to use; with other parameters the network is tried again."""
        if wanted != self._wanted:
            self._wanted, self._failures, self.reason = wanted, 0, ""
        return wanted.built_in() if self.reason else wanted

    def fail(self, error: NetworkError) -> bool:
        """Note a lost frame; returns whether the built-in parts take over from now on."""
        self._failures += 1
        if self._failures < MOST_FAILURES or self.reason:
            return False
        self.reason = (
            f"a network failed {MOST_FAILURES} times in a row, and the built-in matcher and "
            f"restorer stand in until a parameter changes: {error}")
        return True

    def succeed(self) -> None:
        """Note a frame that was processed."""
        self._failures = 0
