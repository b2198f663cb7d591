# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged parts of replays that are gone on from: the whole result, or one sentence."""

from __future__ import annotations

import json
import random
import resource
import shutil
import signal
from pathlib import Path

from fuzz import Outcome
from fuzz_replays import command
from hostile import ABSURD_VALUES
from mutations import mutate
from small_bags import FRAMES, StoragePlugin, write_ros2

import uw_visibility.replay.report.report as report
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.messages.processor import warm_up


class Cases:
    """A partial result of two frames or so, or a complete one, of which a file is damaged."""

    case = ""

    def __init__(self, folder: Path) -> None:
        report.draw_series = lambda columns: []
        warm_up(PipelineConfig())
        bag = write_ros2(folder / "bag", StoragePlugin.MCAP).parent
        self._out = folder / "out"
        self._words = ["replay", str(bag), "-o", str(self._out), "--jobs", "1"]
        self._partial = self._out.with_name("out.partial")
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (160_000, before[1]))
        command(self._words)
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        self._part = self._partial.rename(folder / "part")
        command(self._words)
        self._result = self._out.rename(folder / "result")

    def run(self, seed: int) -> Outcome:
        """Damage a file of the part and go on from it."""
        rng = random.Random(seed)
        for left in (self._out, self._partial, self._out.with_name("out.partial.old")):
            shutil.rmtree(left, ignore_errors=True)
        complete = rng.random() < 0.3
        folder = self._out if complete else self._partial
        shutil.copytree(self._result if complete else self._part, folder)
        files = sorted(f for f in folder.rglob("*") if f.is_file())
        if complete:
            # Nothing else is read.
            files = [folder / "replay.json", folder / "frames.csv"]
        file = rng.choice(files)
        if file.suffix == ".json" and rng.random() < 0.5:
            state = json.loads(file.read_text())
            key = rng.choice(list(state))
            state[key] = rng.choice([v for v in ABSURD_VALUES if v == v])
            file.write_text(json.dumps(state))
            what = f"{key} = {str(state[key])[:20]!r}"
        elif file.stat().st_size:
            what, content = mutate(file.read_bytes(), rng)
            file.write_bytes(content)
        else:
            what = "nothing"
        self.case = f"{file.name} {what}"
        code, said = command([*self._words, "--resume"])
        verdict = "refused" if code == 2 and said else f"exit code {code}"
        if code == 0 and not complete:
            frames = json.loads((self._out / "replay.json").read_text())["frames"]
            verdict = "read" if frames == FRAMES else f"{frames} frames"
        elif complete and said:
            verdict = "read"
        if "internal error," in said or "Traceback" in said:
            verdict = "internal"
        return Outcome(self.case, verdict, said)
