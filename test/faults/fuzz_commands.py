# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The command with absurd arguments, and with files that are none."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
from pathlib import Path

from fuzz import Outcome
from fuzz_replays import command
from small_bags import StoragePlugin, scene, write_ros2

from uw_visibility.images.files import write_png

NUMBERS = (
    "0", "1", "-1", "2", "3", "0.5", "nan", "inf", "-inf", "1e300", "-1e300", "1e-300", "1e999",
    "9" * 300, "9" * 5000, "0x10", "1_000", "", " ", "a", "\0", "\x1b[2J", "é", "\udcff", "1,5",
    "2147483648", "99999", "120",
)
NAMES = (
    "left.png", "right.png", "small.png", "text.yaml", "empty", "pipe", "loop", "folder", "absent",
    "bag", "bag/metadata.yaml", "n" * 300, "null\0byte", "\udcff", "\x1b[2J",
)
DEVICES = ("/dev/zero", "/dev/null", "/dev/full", "/", "", ".", "/proc/self/mem", "/" + "x/" * 3000)
# Options of each command: names, and how many values each takes.
OPTIONS = {
    "enhance": {
        "--focal-length": 1, "--baseline": 1, "--principal-point": 2, "--calibration": 1,
        "--max-disparity": 1, "--params-file": 1, "-o": 1, "--force": 0,
    },
    "replay": {
        "--rectify": 0, "--params-file": 1, "--calibration": 1, "--left": 1, "--right": 1,
        "--left-info": 1, "--right-info": 1, "--depth-sensor": 1, "--start": 1, "--duration": 1,
        "--every": 1, "--list": 0, "--force": 0, "--resume": 0, "--images": 1, "--geo": 1,
        "--origin": 2, "--match-original": 0, "--join": 1, "--join-tolerance": 1,
        "--turbidity": 1, "--netcdf": 0, "--parquet": 0, "--all-topics": 0, "-o": 1,
    },
    "calibrate": {
        "--rectify": 0, "--params-file": 1, "--left": 1, "--depth-sensor": 1, "--start": 1,
        "--duration": 1, "--every": 1, "--force": 0, "-o": 1,
    },
    "simulate": {
        "--force": 0, "--rate": 1, "--width": 1, "--height": 1, "--focal-length": 1,
        "--baseline": 1, "--seed": 1, "--depth": 2, "--attenuation": 2, "--speed": 1,
        "--exposure": 1, "--depth-stddev": 1, "--noiseless": 0, "--marine-snow": 1,
        "--caustics": 1, "--threads": 1, "-o": 1,
    },
    # A dataset that is none, since the work on one takes its time.
    "evaluate": {
        "--force": 0, "--attenuation": 1, "--depth": 1, "--frames": 1,
        "--quick": 0, "--params-file": 1, "--jobs": 1, "-o": 1,
    },
    "warmup": {}, "demo": {}, "no-such-command": {},
}
SIZES = ("--width", "--height")
PATHS = ("--calibration", "--params-file", "--turbidity", "-o")
TOPICS = ("--left", "--right", "--left-info", "--right-info", "--depth-sensor", "--geo", "--join")


class Cases:
    """Command lines of all commands."""

    case = ""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._bag = write_ros2(folder / "bag", StoragePlugin.MCAP).parent
        left, right = scene(1)
        write_png(folder / "left.png", left)
        write_png(folder / "right.png", right)
        write_png(folder / "small.png", left[:10, :10])
        (folder / "text.yaml").write_text("a: [1, 2")
        (folder / "empty").touch()
        os.mkfifo(folder / "pipe")
        (folder / "loop").symlink_to(folder / "loop")
        (folder / "folder").mkdir()
        self._paths = [*(str(folder / name) for name in NAMES), *DEVICES]
        files = [str(folder / f"{side}.png") for side in ("left", "right")]
        out = ["-o", str(folder / "out")]
        # Compiling does not count.
        command(["enhance", *files, "--focal-length", "90", "--baseline", "0.1", *out])
        command(["simulate", "--frames", "1", "--width", "96", "--height", "72", *out])
        self._tidy_up()

    def run(self, seed: int) -> Outcome:
        """Run a command line."""
        rng = random.Random(seed)
        name = rng.choice([*OPTIONS, "enhance", "replay", "replay"])
        words = self._words(name, rng)
        shown = " ".join(word if len(word) < 60 else word[:57] + "..." for word in words)
        self.case = shown.encode(errors="replace").decode()
        code, said = command(words)
        self._tidy_up()
        verdict = {0: "read", 2: "refused", 1: "refused"}.get(code, f"exit code {code}")
        if code and not said:
            verdict = "silent"
        if "internal error," in said or "Traceback" in said:
            verdict = "internal"
        if len(said) > 20_000 or any(not c.isprintable() and c != "\n" for c in said):
            verdict = "unprintable"
        return Outcome(self.case, verdict, said[-1000:])

    def _words(self, name: str, rng: random.Random) -> list[str]:
        words = [name]
        out = str(self._folder / "out")
        if name == "enhance":
            files = [str(self._folder / f"{side}.png") for side in ("left", "right")]
            words += [f if rng.random() < 0.8 else rng.choice(self._paths) for f in files]
            words += ["--focal-length", "90", "--baseline", "0.1", "-o", out]
        elif name in ("replay", "calibrate"):
            words += [str(self._bag) if rng.random() < 0.8 else rng.choice(self._paths)]
            words += ["-o", out, "--jobs", rng.choice(("1", "1", "1", "1", "-1", "a", "100000000"))]
        elif name == "simulate":
            words += ["-o", out, "--frames", rng.choice(("1", "1", "1", "0", "-1", "9" * 300)),
                      "--width", "96", "--height", "72"]
        elif name == "evaluate":
            words += ["-o", out, rng.choice([p for p in self._paths if p]), "--quick"]
        elif name in ("warmup", "demo"):
            words += ["--no-such-option"]
        options = OPTIONS[name]
        for _ in range(rng.choice((0, 1, 1, 2, 3)) if options else 0):
            option = rng.choice(list(options))
            words += [option, *(self._value(option, rng) for _ in range(options[option]))]
        if rng.random() < 0.1:
            word = rng.choice((*NUMBERS, "--", "-", "--debug", "-h"))
            words.insert(rng.randrange(len(words)), word)
        return words

    def _value(self, option: str, rng: random.Random) -> str:
        if option in PATHS:
            return rng.choice(self._paths)
        if option in TOPICS:
            return rng.choice(("/left/image_rect", "/right/camera_info", "/depth_sensor", "/absent",
                               "", "\x1b[2J", "/" + "x" * 5000))
        # What is large and allowed takes its time.
        return rng.choice([n for n in NUMBERS if n != "99999" or option not in SIZES])

    def _tidy_up(self) -> None:
        for entry in self._folder.iterdir():
            if entry.name.startswith(("out", ".out")):
                with contextlib.suppress(OSError):
                    shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
