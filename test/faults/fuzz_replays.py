# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged recordings, replayed by the command: a result, or one sentence."""

from __future__ import annotations

import contextlib
import io
import json
import random
import shutil
from pathlib import Path

from fuzz import Outcome
from fuzz_bags import DamagedBags

import uw_visibility.replay.report.report as report
from uw_visibility.cli import main
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.messages.processor import warm_up


class Cases:
    """Damaged bags, replayed."""

    case = ""

    def __init__(self, folder: Path) -> None:
        self._bags = DamagedBags(folder)
        self._out = folder / "out"
        # Drawing takes longer than all else of a short replay.
        report.draw_series = lambda columns: []
        # Compiling does not count.
        warm_up(PipelineConfig())

    def run(self, seed: int) -> Outcome:
        """Damage a bag and replay it."""
        self.case, source = self._bags.damage(random.Random(seed))
        shutil.rmtree(self._out, ignore_errors=True)
        shutil.rmtree(self._out.with_name("out.partial"), ignore_errors=True)
        code, said = command(["replay", str(source), "-o", str(self._out), "--jobs", "1",
                              "--images", "1"])
        if code == 0:
            state = json.loads((self._out / "replay.json").read_text())
            said += "; ".join(state["unusable"])
            verdict = "read" if state["frames"] == 4 and not state["unusable"] else "partly"
        else:
            verdict = "refused" if code in (1, 2) and said else f"exit code {code}"
        if "internal error," in said or "Traceback" in said:
            verdict = "internal"
        if any(not c.isprintable() and c != "\n" for c in said):
            verdict = "control characters"
        return Outcome(self.case, verdict, said)


def command(words: list[str]) -> tuple[int, str]:
    """Run the command; returns its exit code and what it said."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(words)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
    return code, out.getvalue() + err.getvalue()
