# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Outcomes of the frames that the node processed, and their diagnostics."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from uw_visibility.compute.jit import counts
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.ros.inputs import SILENCE
from uw_visibility.ros.monitor import (
    ERROR,
    OK,
    SHOWN_REASONS,
    WARN,
    Finding,
    ReasonLog,
    RecentCounts,
)
from uw_visibility.status import Status
from uw_visibility.water.filter import FilteredWater


class PipelineState:
    """Counts frames by their outcome; written by the worker, read by the diagnostics.

    Parameters
    ----------
    failures : ReasonLog
        Logs why frames gave no result.

    Attributes
    ----------
    ready : bool
        Whether the pipeline is compiled.
    processed, refused, failed : int
        Frames whose results were published; those that cannot be used; those
        lost to an error inside.
    calibrations : int
        How often CameraInfo was new.
    failures : ReasonLog
        Why frames gave no result.
    """

    def __init__(self, failures: ReasonLog) -> None:
        self.ready = False
        self.processed = self.refused = self.failed = 0
        self.calibrations = 0
        self.failures = failures
        self._recent = RecentCounts(SILENCE)
        self._lock = threading.Lock()
        self._busy_since: float | None = None
        self._answered = 0.0
        self._problem = ""
        self._result: FrameResult | None = None
        self._filtered: FilteredWater | None = None
        self._latency = self._around = 0.0

    @contextmanager
    def busy(self) -> Iterator[None]:
        """Note that a frame is being processed."""
        self._busy_since = time.monotonic()
        try:
            yield
        finally:
            self._busy_since = None

    def add(
        self, result: FrameResult, latency: float, around: float,
        filtered: FilteredWater | None = None,
    ) -> None:
        """Note a result that was published.

        Parameters
        ----------
        result : FrameResult
            What the pipeline found.
        latency : float
            Time since the image's stamp, s.
        around : float
            What reading the images and publishing the messages took, ms.
        filtered : FilteredWater, optional
            The water filtered up to this frame.
        """
        with self._lock:
            self._result, self._latency, self._problem = result, latency, ""
            self._around, self._filtered = around, filtered
            self._answered = time.monotonic()
            self.processed += 1

    def refuse(self, reason: str) -> None:
        """Note a frame that cannot be used."""
        with self._lock:
            self._problem = reason
            self.failures.add(reason)
            self.refused += 1

    def fail(self, reason: str, details: str) -> None:
        """Note a frame that was lost to an error inside."""
        with self._lock:
            self._problem = reason
            self.failures.add(reason, details)
            self.failed += 1

    def obstacle(self) -> str:
        """Return what holds up every frame, or nothing."""
        if not self.ready:
            return f"the pipeline is being compiled, {counts.compiled} kernels so far"
        busy = self._busy_since
        if busy is not None and time.monotonic() - busy > SILENCE:
            return "the pipeline is still busy with one frame"
        return ""

    def silence(self) -> str:
        """Return why frames come in but no results go out, or nothing where they do."""
        if time.monotonic() - self._answered <= SILENCE:
            return ""
        return self._problem or "no frame was processed yet"

    def diagnose(self, silence: str, skipped: int) -> Finding:
        """Return level, message and numbers.

        Parameters
        ----------
        silence : str
            Why there is no output, or nothing where there is.
        skipped : int
            Frames that newer ones replaced.
        """
        counts = {
            "processed": self.processed, "refused": self.refused, "failed": self.failed,
            "skipped": skipped,
        }
        recent = self._recent.update(time.monotonic(), counts)
        rate = recent.get("processed", 0) / max(self._recent.duration, 1e-9)
        values: dict[str, Any] = {f"frames {name}": count for name, count in counts.items()}
        values["rate (Hz)"] = f"{rate:.2f}"
        values["calibrations"] = self.calibrations
        if self._result is not None:
            values |= _values(self._result)
            values |= _filter_values(self._filtered)
            values["around the pipeline (ms)"] = f"{self._around:.1f}"
            values["latency (ms)"] = f"{1e3 * self._latency:.1f}"
        failures = self.failures.selection(SHOWN_REASONS)
        values |= {f"problem: {reason}": count for reason, count in failures.items()}
        if silence:
            stopped = self.processed > 0 or self.refused + self.failed > 0
            return Finding(ERROR if stopped else WARN, f"no output: {silence}", values)
        missing = self._missing()
        if recent.get("refused") or recent.get("failed"):
            level = ERROR if recent.get("failed") else WARN
            lost = "; ".join(filter(None, (missing, "frames were lost lately")))
            return Finding(level, self._problem or lost, values)
        survey = self._filtered.survey if self._filtered is not None else None
        if survey is not None:
            return Finding(OK, f"{rate:.1f} frames per second; water of a survey: {survey}", values)
        if missing:
            return Finding(WARN, missing, values)
        return Finding(OK, f"{rate:.1f} frames per second", values)

    def _missing(self) -> str:
        """Return what the last frame does not tell, and why; nothing where it tells the water."""
        if self._result is None:
            return ""
        status, distance = self._result.status, self._result.visibility.status
        if status is not Status.OK:
            return f"the water is not assessable: {status}"
        if distance is not Status.OK:
            return f"the visibility distance is not assessable: {distance}"
        return ""


def _filter_values(filtered: FilteredWater | None) -> dict[str, Any]:
    """Return the filter's numbers, by name."""
    if filtered is None:
        return {}
    return {
        "filter": filtered.event,
        "rejected by the filter": f"{filtered.rejected} of {filtered.assessed} frames",
        "rejected by the filter in a row": filtered.rejected_in_a_row,
        "survey": filtered.survey or "none",
    }


def _values(result: FrameResult) -> dict[str, Any]:
    return {
        "status": result.status,
        "visibility status": result.visibility.status,
        "depth status": result.visibility.depth_status,
        "support points": result.stereo.support_points,
        "coverage": f"{result.stereo.coverage:.3f}",
        "matched fraction": f"{result.stereo.matched_fraction:.3f}",
    } | {f"{stage} (ms)": f"{duration:.1f}" for stage, duration in result.timing_ms.items()}
