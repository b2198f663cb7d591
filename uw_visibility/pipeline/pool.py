# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pool of pipelines for frames that are processed at once."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.stereo.rig import StereoRig


class PipelinePool:
    """Pool of pipelines of one rig and configuration, as many as frames overlap.

    They share their threads: a frame alone has all of them.

    Parameters
    ----------
    rig : StereoRig
        Geometry of the rectified pair.
    config : PipelineConfig
        Parameters.

    Attributes
    ----------
    made_for : tuple
        Rig and configuration.

    Raises
    ------
    InputError
        As `Pipeline` does.
    """

    def __init__(self, rig: StereoRig, config: PipelineConfig) -> None:
        self.made_for = rig, config
        self._workers = Workers(config.threads)
        self._free = [Pipeline(rig, config, self._workers)]
        self._lock = threading.Lock()

    @contextmanager
    def pipeline(self) -> Iterator[Pipeline]:
        """Lend a pipeline that no other frame uses."""
        with self._lock:
            free = self._free.pop() if self._free else None
        lent = free or Pipeline(*self.made_for, self._workers)
        try:
            yield lent
        finally:
            with self._lock:
                self._free.append(lent)
